"""Results of runs: gains, series, maps, impulse responses, and their files."""

from meshtrace.stored import load as load
