"""Prices of calls: public list prices of known models, None for all others."""

from __future__ import annotations

from llm_flock.llm.port import Usage

LISTED = frozenset({"openai", "anthropic", "deepseek"})
"""Providers with a price list, which holds at their own addresses."""


def cost_usd(provider: str | None, model: str, usage: Usage) -> float | None:
    """Price of one call by the installed lists [US dollars], nothing is downloaded; None where no price is known."""
    provider = (provider or "").removesuffix("-responses")  # the same list, whichever interface is asked
    if provider not in LISTED:
        return None
    from genai_prices import calc_price
    from genai_prices.types import Usage as PricedUsage

    tokens = PricedUsage(
        input_tokens=usage.input, output_tokens=usage.output, cache_read_tokens=min(usage.cached, usage.input)
    )
    try:
        return float(calc_price(tokens, model, provider_id=provider).total_price)
    except LookupError:
        return None
