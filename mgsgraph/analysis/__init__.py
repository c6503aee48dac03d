"""What the covariance knows: questions to the posterior, consistency of the priors, reliability, weak directions."""
