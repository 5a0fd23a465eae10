"""Short forms that may stand for a map or a rival without a name: proposed, never named."""
