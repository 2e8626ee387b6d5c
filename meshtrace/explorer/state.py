"""State of the explorer: a link as given and the values of the controls that were moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

from meshtrace.comms.ook import OokLink
from meshtrace.errors import require_keys
from meshtrace.explorer.controls import (
    BY_NAME,
    CHOICES,
    GIVEN,
    Table,
    value_of,
    with_choice,
    with_value,
)
from meshtrace.scenario import Scenario


@dataclass(frozen=True)
class State:
    """A scenario with the moves of its controls and the time of its sea.

    Parameters
    ----------
    given : Scenario
        The link that the explorer was started with.
    moves : tuple of (str, object)
        Values of the moved controls by name, in the units of the page; "water" and "light" are
        words of `controls.CHOICES`.
    time : float
        Time of the sea [s].

    Notes
    -----
    Moves act on the link as given, not on each other: a move to a wind of 0 m/s and back returns
    the same sea, and a control at its value as given is not moved.

    Examples
    --------
    >>> state = State(Scenario.from_toml(""))
    >>> moved = state.moved({"depth": 12.0})
    >>> state.values["depth"], moved.values["depth"]
    (10.0, 12.0)
    >>> moved.scenario.link.transmitter.depth
    12.0
    """

    given: Scenario
    moves: tuple[tuple[str, Any], ...] = ()
    time: float = 0.0

    def moved(self, values: Mapping[str, Any]) -> Self:
        """Return the state after moves of controls.

        Raises
        ------
        Refused
            If a control is unknown, or its value or the link that it makes is not allowed.
        """
        require_keys(values, [*BY_NAME, *CHOICES])
        start = State(self.given).settings
        moves = {**dict(self.moves), **values}
        moves = {name: value for name, value in moves.items() if value != start[name]}
        state = replace(self, moves=tuple(sorted(moves.items())))
        state.scenario  # noqa: B018 - refuses values that are not allowed
        return state

    def at(self, time: float) -> Self:
        """Return the state at another time of the sea [s]."""
        return replace(self, time=float(time))

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the moved controls."""
        if not self.moves:
            return self.given
        config = self._config
        if self.given.detector is None and "bit_rate" not in dict(self.moves):
            config = {key: table for key, table in config.items() if key != "detector"}
        return Scenario.from_config(config)

    @cached_property
    def detector(self) -> OokLink:
        """Transmission that belongs to the link: that of the scenario, or the physical preset."""
        return OokLink.of_link(self.scenario.link, self.scenario.detector or "physical")

    @cached_property
    def values(self) -> dict[str, float | None]:
        """Values of the controls in the units of the page; None for those a link does not have."""
        return {name: value_of(self._config, control) for name, control in BY_NAME.items()}

    @property
    def settings(self) -> dict[str, Any]:
        """Values of all controls, with the words chosen for water and light."""
        words = dict.fromkeys(CHOICES, GIVEN)
        return {**self.values, **words, **{k: v for k, v in self.moves if k in CHOICES}}

    @cached_property
    def channel(self) -> Scenario:
        """The scenario without detector and light above the sea: the inputs of a gain."""
        return self.scenario.replace(detector=None, daylight=None)

    @cached_property
    def _config(self) -> Table:
        """Tables of the moved link, with the bit rate in use."""
        config: Table = {"detector": {"bit_rate": OokLink().bit_rate}, **self.given.to_config()}
        for name, value in self.moves:
            if name in CHOICES:
                config = with_choice(config, name, value)
            else:
                config = with_value(config, BY_NAME[name], value)
        return config
