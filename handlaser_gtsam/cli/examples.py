"""Examples that the help of every verb ends with; they run as written, in this order, in one folder.

A line that ends with a backslash goes on, so that nothing is wider than 50 columns.
"""

EXAMPLES = {
    "calibrate": (
        "handlaser calibrate recording.csv",
        "handlaser calibrate recording.csv \\\n    --rig rig.toml --out calibration.json",
        "handlaser calibrate recording.csv \\\n    --rig rig.toml --verbose --cross-check",
        "handlaser calibrate recording.csv --json \\\n    --range-sigma-mm 0.03 --poses exact",
    ),
    "check": (
        "handlaser check recording.csv",
        "handlaser check recording.csv --rig rig.toml",
    ),
    "convert": (
        "handlaser convert recording.csv",
        "handlaser convert recording.csv \\\n    --pose-format ros --out again.csv",
        "handlaser convert recording.csv \\\n    --pose-format ros --write-log logs.toml",
    ),
    "export": (
        "handlaser export calibration.json --to kuka",
        "handlaser export calibration.json --to urdf \\\n    --link tool0 --out beams.urdf",
        "handlaser export calibration.json --to c \\\n    --out beams.h",
    ),
    "plan": (
        "handlaser plan recording.csv --rig rig.toml \\\n    --stations 12 --out stations.csv",
        "handlaser plan recording.csv --rig rig.toml \\\n    --stations 5 --picture forecast.svg",
    ),
    "plot": (
        "handlaser plot recording.csv --rig rig.toml \\\n    --out pictures",
        "handlaser plot calibration.json --out mounts",
    ),
    "simulate": (
        "handlaser simulate made",
        "handlaser simulate made --scene arm --beams 2 \\\n    --k1 0.01 --seed 7 --force",
    ),
    "study": (
        "handlaser study study.toml --runs 4",
        "handlaser study study.toml --runs 4 \\\n    --out runs.parquet --jobs 2",
    ),
    "validate": (
        "handlaser validate recording.csv --rig rig.toml",
        "handlaser validate recording.csv \\\n    --calibration calibration.json",
    ),
    "watch": (
        "handlaser watch .",
        "handlaser watch recording.csv --rig rig.toml \\\n    --port 9000 --open",
    ),
}
"""What a person copies, by verb; `watch` runs until it is stopped. The files stand in
examples/gripper and examples/study."""
