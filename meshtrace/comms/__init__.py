"""Communications: pulses, detectors, decisions and link budgets."""
