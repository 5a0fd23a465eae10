"""What a real robot does beyond the paper's model: one small class an effect."""
