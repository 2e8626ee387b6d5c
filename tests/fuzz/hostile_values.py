"""A hundred wrong objects, each with the kinds of parameters that may accept it.

A kind is a word of an annotation, see `accepts`: "float", "int", "bool", "str", "path", "array",
"none", "sequence", "mapping", "callable". A value without kinds is accepted by none of them.
"""

import datetime
import decimal
import fractions
import math
import pathlib

import numpy as np
import pandas as pd
import xarray as xr


class Unwritable:
    """An object whose text cannot be had."""

    def __repr__(self):
        raise RuntimeError("no text")

    __str__ = __repr__


class Endless:
    """A sequence that numpy reads without end."""

    def __len__(self):
        return 3

    def __getitem__(self, i):
        return self


class Mine(float):
    """A number of a user's own class, whose text cannot be had."""

    def __repr__(self):
        raise RuntimeError("no text")

    __str__ = __repr__


def nested(n=2000):
    value = []
    for _ in range(n):
        value = [value]
    return value


def cyclic():
    value = []
    value.append(value)
    return value


NUMBER = ("float", "array")
WHOLE = ("float", "int", "array")
LIST = ("array", "sequence")

# name: (value or function that makes it, kinds of parameters that may accept it)
VALUES = {
    "None": (None, ("none",)),
    "bytes": (b"x", ()),
    "bytearray": (bytearray(b"x"), ()),
    "memoryview": (memoryview(b"xx"), ()),
    "long bytes": (b"5" * 5000, ()),
    "digits in bytes": (b"5", ()),
    "empty text": ("", ("str", "path")),
    "word": ("x", ("str", "path")),
    "digits": ("5", ("str", "path")),
    "nan in a text": ("nan", ("str", "path")),
    "5,000 letters": ("a" * 5000, ("str", "path")),
    "NUL": ("a\x00b", ("str", "path")),
    "surrogate": ("\ud800", ("str", "path")),
    "lines": ("a\nb\r\nc", ("str", "path")),
    "escape": ("\x1b[2J", ("str", "path")),
    "braces": ("{0!r} %s %(x)s", ("str", "path")),
    "dotted": ("a.b.c", ("str", "path")),
    "module": ("os:system", ("str", "path")),
    "numpy's text": (np.str_("x"), ("str", "path")),
    "Path": (pathlib.Path("/nowhere/x"), ("path",)),
    "folder": (pathlib.Path("/"), ("path",)),
    "Path with NUL": (pathlib.Path("a\x00b"), ("path",)),
    "true": (True, ("bool",)),
    "false": (False, ("bool",)),
    "numpy's true": (np.True_, ("bool",)),
    "numpy's false": (np.False_, ("bool",)),
    "array of a truth": (np.array(True), ()),
    "array of truths": (np.array([True, False]), ()),
    "list of truths": ([True, False], ("sequence",)),
    "nan": (math.nan, ()),
    "numpy's nan": (np.float64("nan"), ()),
    "single nan": (np.float32("nan"), ()),
    "inf": (math.inf, ()),
    "-inf": (-math.inf, ()),
    "numpy's -inf": (np.float64("-inf"), ()),
    "-0.0": (-0.0, NUMBER),
    "zero": (0, WHOLE),
    "-1": (-1, WHOLE),
    "half": (0.5, NUMBER),
    "2.5": (2.5, NUMBER),
    "-1e-9": (-1e-9, NUMBER),
    "denormal": (5e-324, NUMBER),
    "1e-300": (1e-300, NUMBER),
    "1e30": (1e30, NUMBER),
    "1e300": (1e300, NUMBER),
    "largest": (1.7976931348623157e308, NUMBER),
    "-1e300": (-1e300, NUMBER),
    "2^31": (2**31, WHOLE),
    "2^63": (2**63, WHOLE),
    "2^64": (2**64, WHOLE),
    "-2^63 - 1": (-(2**63) - 1, WHOLE),
    "10^400": (10**400, ()),
    "10^5000": (10**5000, ()),
    "-10^5000": (-(10**5000), ()),
    "Decimal": (decimal.Decimal("0.5"), NUMBER),
    "Decimal nan": (decimal.Decimal("nan"), ()),
    "signalling Decimal": (decimal.Decimal("snan"), ()),
    "Decimal 1e400": (decimal.Decimal("1e400"), ()),
    "Fraction": (fractions.Fraction(1, 3), NUMBER),
    "huge Fraction": (fractions.Fraction(10**5000, 3), ()),
    "number without a text": (Mine(2.5), NUMBER),
    "complex": (1j, ()),
    "real complex": (1 + 0j, ()),
    "numpy's complex": (np.complex128(1.0), ()),
    "array of complex": (np.array([1.0 + 1j]), ()),
    "half precision": (np.float16(0.5), NUMBER),
    "int8": (np.int8(-128), WHOLE),
    "uint64": (np.uint64(2**64 - 1), WHOLE),
    "long double": (np.longdouble("1e4000"), ()),
    "0-d array": (np.array(0.5), NUMBER),
    "0-d nan": (np.array(np.nan), ()),
    "0-d object": (np.array(None), ()),
    "empty array": (np.array([]), LIST),
    "1 in an array": (np.array([1.0]), LIST),
    "3 numbers": (np.array([0.1, 0.2, 0.3]), LIST),
    "7 numbers": (np.arange(7.0), LIST),
    "2-d": (np.ones((2, 3)), LIST),
    "3-d": (np.zeros((2, 2, 2)), LIST),
    "no rows": (np.zeros((0, 3)), LIST),
    "nans": (np.full(3, np.nan), ()),
    "one nan": (np.array([0.5, np.nan, 1.0]), ()),
    "infs": (np.array([np.inf, 1.0]), ()),
    "huge numbers": (np.array([1e308, -1e308]), LIST),
    "structured": (np.zeros(2, dtype=[("a", float), ("b", int)]), ()),
    "texts": (np.array(["a", "b"]), ("sequence",)),
    "texts of numbers": (np.array(["1.0", "2.0"]), ("sequence",)),
    "bytes in an array": (np.array([b"1"]), ("sequence",)),
    "objects": (np.array([None, 1.0], dtype=object), ("sequence",)),
    "lists in an array": (np.array([[], [1]], dtype=object), ("sequence",)),
    "huge integers": (np.array([10**400, 1], dtype=object), ("sequence",)),
    "masked": (np.ma.masked_array([1.0, 2.0], [False, True]), ()),
    "masked number": (np.ma.masked, ()),
    "unmasked": (np.ma.masked_array([1.0, 2.0]), LIST),
    "times in an array": (np.array(["2020-01-01"], dtype="datetime64[s]"), ("sequence",)),
    "read-only": (np.broadcast_to(1.0, (3,)), LIST),
    "backwards": (np.arange(4.0)[::-1], LIST),
    "big-endian": (np.arange(3, dtype=">f8"), LIST),
    "empty list": ([], ("array", "sequence")),
    "empty tuple": ((), ("array", "sequence")),
    "list": ([0.5, 0.6], LIST),
    "tuple of three": ((0.5, 0.6, 0.7), LIST),
    "list of text": (["x"], ("sequence",)),
    "list of None": ([None], ("sequence",)),
    "list with nan": ([1.0, math.nan], ("sequence",)),
    "list with 10^5000": ([1.0, 10**5000], ("sequence",)),
    "ragged": ([[1.0], [1.0, 2.0]], ("sequence",)),
    "lists": ([[1.0, 2.0], [3.0, 4.0]], LIST),
    "nested": (nested, ("sequence",)),
    "cyclic": (cyclic, ("sequence",)),
    "range": (range(3), LIST),
    "endless": (Endless, ()),
    "empty mapping": ({}, ("mapping",)),
    "mapping": ({"x": 1.0}, ("mapping",)),
    "mapping of numbers": ({1: 2, None: 3}, ("mapping",)),
    "deep mapping": ({"a": {"b": {"c": []}}}, ("mapping",)),
    "mapping of 10^5000": ({10**5000: 1}, ("mapping",)),
    "set": ({1.0, 2.0}, ()),
    "frozenset": (frozenset("ab"), ()),
    "generator": (lambda: (x for x in (1.0, 2.0)), ()),
    "iterator": (lambda: iter([1.0]), ()),
    "class": (int, ("callable",)),
    "function": (len, ("callable",)),
    "lambda": (lambda: lambda *a: None, ("callable",)),
    "module itself": (math, ()),
    "object": (object(), ()),
    "no text": (Unwritable(), ()),
    "ellipsis": (..., ()),
    "NotImplemented": (NotImplemented, ()),
    "exception": (ValueError("x"), ()),
    "slice": (slice(None), ()),
    "datetime": (datetime.datetime(2020, 1, 1), ()),
    "timedelta": (datetime.timedelta(1), ()),
    "datetime64": (np.datetime64("2020-01-01"), ()),
    "NaT": (np.datetime64("NaT"), ()),
    "timedelta64": (np.timedelta64(1, "s"), ()),
    "pandas' NaT": (pd.NaT, ()),
    "pandas' NA": (pd.NA, ()),
    "Timestamp": (pd.Timestamp("2020-01-01"), ()),
    "Series": (pd.Series([1.0, 2.0]), LIST),
    "Series with nan": (pd.Series([1.0, None]), ()),
    "Series of texts": (pd.Series(["a"]), ()),
    "Series of truths": (pd.Series([True, False]), ()),
    "DataFrame": (pd.DataFrame({"x": [1.0]}), LIST),
    "DataFrame of texts": (pd.DataFrame({"x": ["a"]}), ()),
    "DataArray": (xr.DataArray([1.0, 2.0]), LIST),
    "Dataset": (xr.Dataset({"x": ("t", [1.0])}), ("mapping",)),
}


def made(name):
    """Return a wrong object."""
    value = VALUES[name][0]
    fresh = callable(value) and getattr(value, "__module__", "") == __name__
    return value() if fresh else value
