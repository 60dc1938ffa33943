#!/usr/bin/env python3
"""Competition of circles: weald, and the same rule on SciPy's k-d tree.

Usage: self_thinning.py --venv FOLDER [--weald PROGRAM] [--plants N ...] [--repeat N]

Installs numpy and scipy into FOLDER. One circle to a square metre, radii from 2 to 10 cm, open
rim; in each of 20 years every circle that meets a larger one dies (all at once), and the others
grow by 1 cm. Radii are single precision on both sides. Agent frameworks (mesa, agentpy) run the
same rule 30 to 700 times slower than the k-d tree and are not timed here.

The number of plant-steps and of the circles left must be equal.
"""

import argparse
import importlib.util
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv


def enter(folder, packages):
    """Goes on in the virtual environment `folder`, made and filled when it is not there."""
    python = os.path.join(os.path.abspath(folder), "bin", "python")
    if not os.path.exists(python):
        venv.create(folder, with_pip=True)
    if os.path.abspath(sys.prefix) != os.path.abspath(folder):
        os.execv(python, [python, *sys.argv])
    for package, module in packages.items():
        if importlib.util.find_spec(module) is None:
            install = [python, "-m", "pip", "install", "--quiet", package]
            if subprocess.run(install, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
                print(f"{package} does not install here: left out")
    importlib.invalidate_caches()


def present(module):
    return importlib.util.find_spec(module) is not None


def timed(work):
    """Result, wall seconds and processor seconds of all threads."""
    wall, cpu = time.perf_counter(), time.process_time()
    made = work()
    return made, time.perf_counter() - wall, time.process_time() - cpu


def weald(program, *arguments):
    """The JSON report of a command; an error of ours is shown and ends the comparison."""
    command = [program, *map(str, arguments), "--json"]
    try:
        answer = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        sys.exit(f"{program}: {error.strerror}; build it with `cargo build --release -p weald-cli`")
    if answer.returncode:
        sys.exit(f"{' '.join(command)}\n{answer.stderr}")
    return json.loads(answer.stdout or "null")


def show(times, ours):
    """Medians, and how many times the processor seconds of `ours` each took."""
    median = {name: [statistics.median(part) for part in zip(*runs)] for name, runs in times.items()}
    print(f"{'':<34}{'CPU s':>10}{'wall s':>10}{'CPU, ours = 1':>16}")
    for name, (wall, cpu) in median.items():
        print(f"{name:<34}{cpu:>10.4f}{wall:>10.4f}{cpu / median[ours][1]:>16.2f}")
    print()


YEARS = 20


def circles(count):
    import numpy as np

    rng = np.random.default_rng(5)
    places = rng.uniform(0, count**0.5, (count, 2))
    return places, rng.uniform(0.02, 0.10, count).astype("float32")


def with_tree(places, radii):
    """Plant-steps, and circles left."""
    import numpy as np
    from scipy.spatial import cKDTree

    growth, steps = np.float32(0.01), 0
    for _ in range(YEARS):
        steps += len(radii)
        pairs = cKDTree(places).query_pairs(2 * float(radii.max()), output_type="ndarray")
        a, b = pairs[:, 0], pairs[:, 1]
        reach = radii[a].astype("float64") + radii[b]
        meets = ((places[a] - places[b]) ** 2).sum(1) < reach * reach
        a, b = a[meets], b[meets]
        # Of equals the first wins, and pairs come with the lower index first.
        lives = np.ones(len(radii), bool)
        lives[np.where(radii[a] >= radii[b], b, a)] = False
        places, radii = places[lives], radii[lives] + growth
    return steps, len(radii)


def compare(arguments, folder, count):
    import numpy as np

    places, radii = circles(count)
    path = os.path.join(folder, f"circles-{count}.csv")
    np.savetxt(path, np.c_[places, radii.astype("float64")], delimiter=",", fmt="%.17g", comments="",
               header="x,y,radius")
    times, theirs = {}, None
    for _ in range(arguments.repeat):
        report = weald(arguments.weald, "bench", "--only", "ecosim", "--input", path, "--repeat", 1)
        figure = report["figures"][0]
        times.setdefault("weald", []).append((figure["seconds"], figure["cpu_seconds"]))
        if present("scipy"):
            theirs, *time_of_run = timed(lambda: with_tree(places, radii))
            times.setdefault("SciPy k-d tree", []).append(time_of_run)
    steps, left = round(figure["value"] * figure["seconds"]), round(figure["result"])
    print(f"{count} circles, {YEARS} years, {steps} plant-steps, medians of {arguments.repeat}")
    show(times, "weald")
    for name, runs in times.items():
        cpu = statistics.median(cpu for _, cpu in runs)
        print(f"{name:<34}{steps / cpu / 1e6:>10.2f} million plant-steps a CPU second")
    if theirs is None:
        return True
    print(f"left: ours {left}, theirs {theirs[1]}; plant-steps: ours {steps}, theirs {theirs[0]}\n")
    return (steps, left) == theirs


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--plants", type=int, nargs="+", default=[10_000, 100_000])
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    enter(arguments.venv, {"numpy": "numpy", "scipy": "scipy"})
    if not present("numpy"):
        sys.exit("numpy is needed to make the circles")
    with tempfile.TemporaryDirectory() as folder:
        agrees = [compare(arguments, folder, count) for count in arguments.plants]
        sys.exit(0 if all(agrees) else 1)


if __name__ == "__main__":
    main()
