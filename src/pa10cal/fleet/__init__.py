"""Many arms, each measured again and again: one summary over all of them."""
