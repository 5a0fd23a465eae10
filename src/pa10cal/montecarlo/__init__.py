"""How far resolver uncertainty moves the flange: drawn cycle by cycle, and in closed form."""
