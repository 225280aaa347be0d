"""Layer 4: superquadrics inflated until they contain the object."""
