"""Studies that repeat simulations: series, ensembles, convergence, performance and sweeps."""
