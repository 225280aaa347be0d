"""Where two maps of objects overlap: scores, consensus, acceptance, refinement."""
