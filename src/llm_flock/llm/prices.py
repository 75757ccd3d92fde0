"""Prices of calls: public list prices of known models, None for all others."""

from __future__ import annotations

from genai_prices import calc_price
from genai_prices.types import Usage as PricedUsage

from llm_flock.llm.port import Usage


def cost_usd(price_id: str | None, model: str, usage: Usage) -> float | None:
    """Price of one call by the list prices that are installed (package `genai-prices`; nothing is downloaded).

    Args:
        price_id: id of the price list (`openai`, `anthropic`, ...), None where none applies.
        model: model name as the provider knows it.
        usage: tokens of the call; the `cached` part of `input` has its own rate.

    Returns:
        US dollars, or None where no price is known.
    """
    if price_id is None:
        return None
    tokens = PricedUsage(
        input_tokens=usage.input, output_tokens=usage.output, cache_read_tokens=min(usage.cached, usage.input)
    )
    try:
        return float(calc_price(tokens, model, provider_id=price_id).total_price)
    except LookupError:
        return None


def price_known(price_id: str | None, model: str) -> bool:
    """Whether `cost_usd` has an answer for this model."""
    return cost_usd(price_id, model, Usage(input=1, output=1)) is not None
