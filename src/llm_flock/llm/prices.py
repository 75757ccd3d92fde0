"""Prices of calls: public list prices of known models, None for all others."""

from __future__ import annotations

from genai_prices import calc_price
from genai_prices.types import Usage as PricedUsage

from llm_flock.llm.port import Usage


def cost_usd(price_id: str | None, model: str, usage: Usage) -> float | None:
    """Price of one call [US dollars] by the list prices that are installed (nothing is downloaded).

    None where no price is known, or without `price_id`, the id of a price list (`openai`, `anthropic`, ...).
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
