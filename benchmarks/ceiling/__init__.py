"""What a learner makes of the residuals of geometry, and what the extended model makes of them."""
