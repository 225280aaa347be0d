"""Layer 3: superquadrics fitted to a mesh."""
