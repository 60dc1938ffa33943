#!/usr/bin/env python3
"""Vector quantization of plants: weald, scikit-learn and faiss on one weighted table.

Usage: clustering.py --venv FOLDER [--weald PROGRAM] [--rows N] [--repeat N] [--many]

Installs numpy, scikit-learn and faiss-cpu into FOLDER. Rows are four measures of plants of six
species (age, vigor, height, wetness), weighted by the inverse square of their distance from the
eye; 64 centres. Both sides use all threads, and CPU seconds add them up. The error is the weighted
mean of the squared distance to the nearest centre, computed here for the peers from their centres
and by weald from its own labels (which can only be larger).

The best error known is the lowest of this run; a fast mode may lie 6.5 % above it.

With --many instead: 256 and 1024 centres, weald's best mode once beside the best of three runs of
scikit-learn's k-means++, whose processor seconds are added up. Those of weald are of the whole
program, with the table read from CSV.
"""

import argparse
import importlib.util
import json
import os
import resource
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


CLUSTERS = 64


def plants(rows):
    """Ages are log-normal and differ between species; the other measures follow from them."""
    import numpy as np

    rng = np.random.default_rng(1)
    species = rng.integers(0, 6, rows)
    age = np.exp(rng.normal(0, 0.6, rows) + 0.25 * (species - 2.5))
    vigor = rng.beta(2 + species % 3, 3, rows)
    height = age**0.7 * (0.5 + vigor) * np.exp(rng.normal(0, 0.1, rows))
    wetness = rng.beta(2, 5, rows) * (0.5 + 0.1 * species)
    weight = 1 / np.maximum(0.03, rng.random(rows)) ** 2
    table = np.stack([age / 6, vigor, height / 5, wetness], 1)
    return np.ascontiguousarray(table), weight / weight.mean()


def error(table, weight, centres):
    import numpy as np

    total = 0.0
    for start in range(0, len(table), 20_000):
        part = table[start:start + 20_000]
        squares = ((part[:, None, :] - centres[None, :, :]) ** 2).sum(2).min(1)
        total += float(np.dot(weight[start:start + 20_000], squares))
    return total / float(weight.sum())


def scikit_learn(table, weight):
    from sklearn.cluster import KMeans

    return KMeans(CLUSTERS, n_init=1, random_state=0).fit(table, sample_weight=weight).cluster_centers_


def faiss_kmeans(table, weight):
    import faiss

    kmeans = faiss.Kmeans(table.shape[1], CLUSTERS, niter=25, seed=1, max_points_per_centroid=10**9)
    kmeans.train(table.astype("float32"), weights=weight.astype("float32"))
    return kmeans.centroids.astype("float64")


def ours(program, path, times, errors):
    report = weald(program, "bench", "--only", "quantize", "--input", path, "--repeat", 2)
    for figure in report["figures"]:
        name = figure["name"].replace("vector quantization,", "weald")
        times.setdefault(name, []).append((figure["seconds"], figure["cpu_seconds"]))
        errors[name] = figure["result"]


def written(rows, folder):
    """The table, its weights, and a CSV file of both."""
    import numpy as np

    table, weight = plants(rows)
    path = os.path.join(folder, "plants.csv")
    np.savetxt(path, np.c_[table, weight], delimiter=",", fmt="%.17g", comments="",
               header="age,vigor,height,wetness,weight")
    return table, weight, path


def children_cpu():
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def compare_many(arguments, folder):
    """Whether weald's best mode is nowhere worse than the best of three k-means++."""
    from sklearn.cluster import KMeans

    table, weight, path = written(arguments.rows, folder)
    is_no_worse = True
    for clusters in (256, 1024):
        before = children_cpu()
        report = weald(arguments.weald, "quantize", "--table", path, "--weight", "weight",
                       "-k", clusters, "--mode", "best")
        our_error, our_cpu = report["weighted_mse"], children_cpu() - before
        errors, before = [], time.process_time()
        for seed in range(3):
            found = KMeans(clusters, n_init=1, random_state=seed).fit(table, sample_weight=weight)
            errors.append(found.inertia_ / float(weight.sum()))
        their_cpu = time.process_time() - before
        print(f"{arguments.rows} rows of 4 to {clusters} centres")
        print(f"{'weald best':<34}error {our_error:.6e}  CPU {our_cpu:.2f} s")
        print(f"{'k-means++, best of three':<34}error {min(errors):.6e}  CPU {their_cpu:.2f} s")
        print(f"{'weald / k-means++':<34}error {our_error / min(errors):.4f}\n")
        is_no_worse &= our_error <= min(errors)
    return is_no_worse


def compare(arguments, folder):
    table, weight, path = written(arguments.rows, folder)
    peers = {"faiss, 25 steps": ("faiss", faiss_kmeans), "scikit-learn KMeans": ("sklearn", scikit_learn)}
    times, errors = {}, {}
    for _ in range(arguments.repeat):
        ours(arguments.weald, path, times, errors)
        for name, (module, run) in peers.items():
            if present(module):
                centres, *time_of_run = timed(lambda: run(table, weight))
                times.setdefault(name, []).append(time_of_run)
                errors[name] = error(table, weight, centres)
    print(f"{arguments.rows} rows of 4 to {CLUSTERS} centres, medians of {arguments.repeat}")
    show(times, "weald fast")
    best = min(errors.values())
    for name, found in errors.items():
        print(f"{name:<34}error {found:.6e}  {found / best:.4f} times the best of this run")
    return errors["weald fast"] <= 1.065 * best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--venv", required=True, help="folder of the virtual environment")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--many", action="store_true", help="256 and 1024 centres, against k-means++")
    arguments = parser.parse_args()
    enter(arguments.venv, {"numpy": "numpy", "scikit-learn": "sklearn", "faiss-cpu": "faiss"})
    if not present("numpy"):
        sys.exit("numpy is needed to make the table")
    if arguments.many and not present("sklearn"):
        sys.exit("scikit-learn is needed to compare many centres")
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(0 if (compare_many if arguments.many else compare)(arguments, folder) else 1)


if __name__ == "__main__":
    main()
