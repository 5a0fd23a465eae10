"""Effects judged by how well blocks of poses are predicted that were left out of the fit."""
