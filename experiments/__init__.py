"""Studies that use the packages and are never installed with them."""
