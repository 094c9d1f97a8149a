"""Rig files and results as they should be, and what befalls their fields.

Values become others of any type, fields stand twice or are gone, brackets nest without end. Everything
is drawn from one `random.Random`, so that a seed is a file.
"""

import json
import math
import random
import re

from .mutated_bytes import mutated_bytes

_VALUE_WORDS = r"""
NaN Infinity -Infinity nan inf -inf 1e308 -1e308 1e999 1e300 0 -1 true false null "0.1" '0.1' []
{} [0.1] [[0.1]] 1e-320 "converged" "\u001b[31m" "\u202e1" "" "\ud800" 0x10 1_0 0.1, 0,1 -
1979-05-27 +0.1 .1 1.
"""
VALUES = (
    *_VALUE_WORDS.split(),
    *('" 1"', f'"{"1" * 201}"', "1" * 400, "1" * 5000, "[" * 3000, "[" * 100_000, '{"a":' * 3000),
)
"""What may stand where a value should, in TOML or JSON."""
TOKEN = re.compile(r'-?\d+\.?\d*(?:e[+-]?\d+)?|"[^"\n]*"|true|false|null')
SCALAR = re.compile(rf"(?<=[:=] )(?:{TOKEN.pattern})")
"""A token that is the whole value of a field; the others stand in lists, most in covariances."""
FIELD = re.compile(r'"[a-z_0-9]+":|^[a-z_]+(?= =)|\[[a-z]+\]$', re.MULTILINE)


def rig_text(rng: random.Random) -> str:
    """Return a rig file."""
    lines = ["[noise]", f"range_sigma_mm = {rng.uniform(0.001, 1.0):.4g}"]
    if rng.random() < 0.7:
        lines.append(f"pose_translation_sigma_mm = {rng.uniform(0.0, 1.0):.4g}")
        lines.append(f"pose_rotation_sigma_deg = {rng.uniform(0.0, 1.0):.4g}")
    else:
        lines.append(f"pose_covariance = {_covariance(6, 1e-4, rng)}")
    lines += ["incidence_sigma_mm = 0.01", "pose_translation_prior_mm = 0.1", "[sensor]"]
    lines += [f"range_mm = [0, {rng.randint(1, 900)}]", "max_incidence_deg = 45"]
    lines += ["linearity_percent = 1.0", "[limits]", "rms_mm = 0.05", "direction_sigma_deg = 0.5"]
    return "\n".join(lines) + "\n"


def result_text(rng: random.Random) -> str:
    """Return the part of a result that says where the beams are, and some of the rest."""
    count = rng.randint(1, 3)
    beams = []
    for i in range(count):
        a, b = rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3)
        c = math.sqrt(1.0 - a * a - b * b)
        mount = {"name": f"{i + 1}", "location_m": [rng.uniform(-0.1, 0.1) for _ in range(3)]}
        k = {"k1": rng.uniform(-0.01, 0.01), "k2_per_m": rng.uniform(-0.1, 0.1)}
        beams.append(
            {
                **mount,
                "direction": [a, b, c],
                "range_error": k,
                "range_error_terms": 2,
                "sigma": None,
            }
        )
    record = {
        "format": "handlaser-calibration",
        "version": 1,
        "status": "converged",
        "message": "",
        "warnings": [],
        "beams": beams,
        "beam_covariance": _covariance(8 * count, 1e-5, rng),
        "fit": {"range_sigma_m": 3e-5, "pose_covariance": _covariance(6, 1e-4, rng), "dof": 9},
    }
    return json.dumps(record, indent=rng.choice((None, 2)))


def _covariance(size: int, sigma: float, rng: random.Random) -> list[list[float]]:
    root = [[rng.gauss(0.0, sigma) for _ in range(size)] for _ in range(size)]
    return [[sum(a * b for a, b in zip(p, q, strict=True)) for q in root] for p in root]


def mutated_text(text: str, rng: random.Random) -> bytes:
    """Return TOML or JSON after one to three mishaps: values, fields twice or gone, nesting, bytes."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind = rng.randrange(8)
        token = rng.choice(list(rng.choice((TOKEN, SCALAR)).finditer(text)) or [None])
        name = rng.choice(list(FIELD.finditer(text)) or [None])
        if kind <= 2 and token is not None:
            text = text[: token.start()] + rng.choice(VALUES) + text[token.end() :]
        elif kind == 3 and token is not None:
            other = rng.choice(list(TOKEN.finditer(text)))
            text = text[: token.start()] + other[0] + text[token.end() :]
        elif kind == 6 and token is not None and token[0][-1:].isdigit():
            text = text[: token.start()] + _other_number(token[0], rng) + text[token.end() :]
        elif kind == 7 and name is not None and name[0].startswith('"'):
            extra = f'"extra": {rng.choice(VALUES)}, '
            text = text[: name.start()] + extra + text[name.start() :]
        elif kind == 4 and name is not None:
            text = text[: name.start()] + _field_again(name[0], rng) + text[name.start() :]
        elif kind == 5 and name is not None:
            text = text[: name.start()] + rng.choice(('"a\\u001bb":', "b", "")) + text[name.end() :]
    data = text.encode("utf-8", "surrogatepass")
    return mutated_bytes(data, rng) if rng.random() < 0.3 else data


def _other_number(number: str, rng: random.Random) -> str:
    """Return a number of nearly the same size, as another program writes it."""
    value = float(number) * rng.choice((1.0, 1.0, 1.0 + 1e-13, 1.5, -1.0))
    return rng.choice((f"{value!r}", f"{value:.3g}", f"{value:.20e}", f"{value:+.6f}"))


def _field_again(name: str, rng: random.Random) -> str:
    """Return a field that stands before its equal, with another value."""
    value = rng.choice(("1", "0.5", "null", '"x"', "[]"))
    if name.startswith('"'):
        return f"{name} {value}, "
    return f"{name}\n" if name.startswith("[") else f"{name} = {value}\n"
