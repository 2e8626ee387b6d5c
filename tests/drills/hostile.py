"""Hostile inputs of fifteen kinds, drawn by a fixed seed.

Each kind is a function of a random generator and a folder of its own; it returns a description,
which reproduces the input, and a function without arguments that puts the input in. That function
returns numbers, or raises: `drill` tells refusals from failures.
"""

from hostile_calls import arguments, commands, environment, links
from hostile_foreign_files import meshes, profiles, records, sequences, spectra
from hostile_own_files import forged, forged_stores, origins, results, stores, studies

KINDS = {
    function.__name__: function
    for function in (
        links, arguments, commands, meshes, spectra, results, origins, stores, studies,
        environment, records, sequences, profiles, forged, forged_stores,
    )
}  # fmt: skip
