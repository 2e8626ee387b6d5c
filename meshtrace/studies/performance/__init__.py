"""Performance of a link: bit error rate, outage and range."""
