"""Time as a channel of its own: what moved between readings while a campaign lasted."""
