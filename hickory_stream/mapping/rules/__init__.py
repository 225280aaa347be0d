"""Pure rules with their numbers: which track an observation belongs to, what merges, splits, lives and ends."""
