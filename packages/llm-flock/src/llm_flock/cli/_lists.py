"""`llm-flock shapes` and `llm-flock models`: what can be flown, and what can be asked."""

from __future__ import annotations

from rich.table import Table

from llm_flock import plugins
from llm_flock.cli._doctor import is_set
from llm_flock.cli._terminal import Screen


def shapes() -> None:
    """List the formations and their possible team sizes."""
    from llm_flock import shapes as formations

    table = Table("shape", "robots", "description")
    for shape in formations.shapes():
        table.add_row(shape.name, shape.legal, shape.description)
    Screen().show(table, copied=("shape",))


def models() -> None:
    """List the model providers, their environment variables, whether these are set, and examples."""
    from llm_flock.llm._providers import PROVIDERS

    table = Table("provider", "key in", "set", "default address", "example")
    for provider in PROVIDERS.values():
        known = "yes" if is_set(provider.key_env) else "no"
        table.add_row(provider.name, provider.key_env, known, provider.base_url or "-", provider.example)
    here = {name: source.example for name, source in plugins.load_all("models")}
    here |= {"simulated": "simulated:ideal", "geometry": "geometry", "replay": "replay:FILE"}
    for name, example in here.items():
        table.add_row(name, "-", "-", "this process", example)
    Screen().show(table, copied=("key in", "default address", "example"))
