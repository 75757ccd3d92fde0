"""Robots with different models, some faulty, over links that lose messages; print what the record shows."""

import llm_flock


def main() -> None:
    mission = llm_flock.Mission(shape="triangle", n_robots=6)
    result = llm_flock.run(
        mission,
        model="0-2=simulated:ideal,3-5=simulated:overshoot@0.3,malformed@0.2,flaky@0.1",
        loss=0.3,
        seed=5,
    )
    figures = result.summary
    print(f"formed: {result.formed} in {figures.rounds} rounds; waypoints by origin: {figures.waypoints}")
    print(f"{figures.model_calls} calls, {figures.calls_rejected} rejected, {figures.calls_failed} failed")


if __name__ == "__main__":
    main()
