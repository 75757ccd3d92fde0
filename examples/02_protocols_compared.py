"""The same start and the same simulated models under three protocols: only the rules differ."""

import llm_flock


def main() -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=10)
    for protocol in ("flock", "paper", "baseline"):
        result = llm_flock.run(mission, protocol=protocol, model="simulated:ideal", seed=7, rounds=40)
        figures = result.summary
        print(
            f"{protocol:8} formed: {result.formed!s:5} plans: {figures.plans_in_use:2} "
            f"distinct goals: {figures.distinct_goals:2} error: {figures.procrustes_mean:.2f}"
        )


if __name__ == "__main__":
    main()
