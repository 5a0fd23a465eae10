"""Commands of pa10cal, one function each."""
