"""Pictures of maps, alignments, paths and perception, drawn without a display."""
