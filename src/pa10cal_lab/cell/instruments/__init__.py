"""How each kind of instrument measures: one file a kind, named like it in campaign.yaml."""
