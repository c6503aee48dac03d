"""What the covariance knows: questions to the posterior, honesty of the priors, reliability, weak directions."""
