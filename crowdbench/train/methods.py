"""The training methods, by the networks that they train.

A further method is one more line in `METHODS`. The options of `crowdbench train`, its errors and the text of cards
follow from it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from crowdbench.networks import card as cards
from crowdbench.train.driving_requests import PPORequest, ValueRequest
from crowdbench.train.method import Request
from crowdbench.train.social_gan_request import SocialGANRequest
from crowdbench.utils.errors import InputError, find_named

METHODS: dict[str, type[Request]] = {
    "cadrl": ValueRequest,
    "lstm_rl": ValueRequest,
    "ppo": PPORequest,
    "ppo_attention": PPORequest,
    "sarl": ValueRequest,
    "sgan": SocialGANRequest,
}
"""The class of requests by the name of the network, which is also the name of a planner or predictor."""


def method_of(network: str) -> type[Request]:
    """The method that trains a network. Raises InputError where no network has the name."""
    return find_named("network", network, METHODS)


def own_options() -> dict[str, tuple[dataclasses.Field[Any], list[str]]]:
    """The options that only some networks have, made by `option`: by name, each with these networks.

    Methods that share the name of an option mean the same by it: the first of them describes it.
    """
    found: dict[str, tuple[dataclasses.Field[Any], list[str]]] = {}
    for network, method in METHODS.items():
        for field in dataclasses.fields(method):
            if field.metadata:
                found.setdefault(field.name, (field, []))[1].append(network)
    return found


def check_options(network: str, options: Mapping[str, Any]) -> None:
    """Check that options belong to a network and do not contradict each other.

    Args:
        network: The name of the network.
        options: The options that a user has given, by field name of the request.

    Raises:
        InputError: There is no such network, an option is another network's or not finite, or two set the same.
    """
    method = method_of(network)
    for name, (_, networks) in own_options().items():
        if name in options and network not in networks:
            raise InputError(f"--{name.replace('_', '-')} is not for {network}, only for {_join(networks)}")
    for name, value in options.items():
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"--{name.replace('_', '-')} is {value}, but must be a finite number")
    if "minutes" in options and method.length in options:
        raise InputError(f"--minutes and --{method.length} both say how long to train: give one")
    method.check(options)


def headline(card: Mapping[str, Any]) -> str:
    """The card of trained weights in one line."""
    trained = card["training"]
    rest = method_of(card["network"]).card_text(card).headline
    return f"{card['network']}, seed {trained['seed']}, {trained['minutes']:.1f} min {rest}"


def built_in_weights() -> list[tuple[str, str]]:
    """Name and headline of the built-in weights."""
    # Imported here, because torch takes a second and the options are shown without it.
    from crowdbench.networks.weights import built_in, read_card

    return [(path.stem, headline(read_card(path))) for path in built_in()]


def markdown(card: Mapping[str, Any]) -> str:
    """The card of trained weights for people."""
    text = method_of(card["network"]).card_text(card)
    return cards.markdown(card, text.rows, text.figures)


def _join(names: list[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last
