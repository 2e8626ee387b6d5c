"""Results of simulations, with files and tables."""
