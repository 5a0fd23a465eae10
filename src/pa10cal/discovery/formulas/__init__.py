"""From a map, or a rival without a name, to a short formula that does as well."""
