"""What a real robot does beyond its model: one small class an effect, found by looking here."""
