"""Effects judged by how well blocks of poses are predicted that were held out of the fit."""
