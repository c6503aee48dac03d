"""The adjustment: a network becomes a factor graph, the graph is solved, and the posterior is read off."""
