"""A continuous curve as straight links with their ends on it, and the joint angles between them."""
