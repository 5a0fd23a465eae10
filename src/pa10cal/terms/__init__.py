"""Everything that moves the chain off nominal, one class a term."""
