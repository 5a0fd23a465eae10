"""Effects judged by the evidence of repeated readings, the pose being its unit."""
