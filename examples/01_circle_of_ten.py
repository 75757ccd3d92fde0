"""Ten robots with simulated language models form a circle; print how it went."""

import llm_flock


def main() -> None:
    mission = llm_flock.Mission(shape="circle", n_robots=10)
    result = llm_flock.run(mission, model="simulated:ideal", seed=7)
    figures = result.summary
    print(f"formed: {result.formed}, in round {figures.rounds_to_formed} (lower bound {figures.lower_bound_rounds})")
    print(f"smallest separation: {figures.min_separation:.2f} (safe distance {mission.safe_distance:g})")
    print(f"positions: {result.positions.shape} = (rounds + 1, robots, coordinates)")


if __name__ == "__main__":
    main()
