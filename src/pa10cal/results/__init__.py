"""One typed record per result file, used by the writer and by every reader."""
