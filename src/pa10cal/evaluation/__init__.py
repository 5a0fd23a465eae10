"""Models judged on configurations that were never used to fit them."""
