"""Record a run, read it back and draw it, as every figure and analysis does."""

import tempfile
from pathlib import Path

import llm_flock
import llm_flock_view as figures


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        result = llm_flock.run(llm_flock.Mission(shape="cross", n_robots=5), seed=1, out=folder)
        record = llm_flock.read_record(Path(folder) / "run.mcap")
        print(f"{len(record.llm)} model calls, {record.positions.shape[0] - 1} rounds, formed: {result.formed}")
        first = record.llm[0]
        print(f"robot {first.robot} was told: {first.messages[-1].text[:60]!r} ...")
        target = Path(folder) / "snapshots.png"
        figures.save(figures.snapshots(record), target)
        print(f"figure of {target.stat().st_size // 1024} kB")


if __name__ == "__main__":
    main()
