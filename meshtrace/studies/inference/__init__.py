"""Inference of the parameters of a link from measured gains."""
