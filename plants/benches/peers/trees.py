#!/usr/bin/env python3
"""Tree models a second: weald's Weber-Penn aspen and ez-tree's presets.

Usage: trees.py --node FOLDER [--weald PROGRAM] [--trees N] [--repeat N]

Installs ez-tree and three from npm into FOLDER; needs node and npm. The trees are not the same
trees: weald grows 60-year aspens whose leaves are instances (counted with every leaf), ez-tree
grows its own presets with all leaves in one mesh. So rates are given a tree and a triangle, and
nothing is checked but that both make some. weald uses one thread; node's collector may use more.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys

PRESETS = ["Aspen Medium", "Aspen Large", "Oak Medium", "Oak Large"]


def installed(folder):
    """Whether ez-tree is there, installing it if it can be."""
    if not (shutil.which("node") and shutil.which("npm")):
        print("node or npm is absent: ez-tree left out")
        return False
    if os.path.isdir(os.path.join(folder, "node_modules", "@dgreenheck", "ez-tree")):
        return True
    os.makedirs(folder, exist_ok=True)
    install = ["npm", "install", "--silent", "--prefix", folder, "@dgreenheck/ez-tree", "three"]
    if subprocess.run(install, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode:
        print("ez-tree does not install here: left out")
        return False
    return True


def report(command):
    try:
        answer = subprocess.run(command, capture_output=True, text=True)
    except OSError as error:
        sys.exit(f"{command[0]}: {error.strerror}; build it with `cargo build --release -p weald-cli`")
    if answer.returncode:
        sys.exit(f"{' '.join(command)}\n{answer.stderr}")
    return json.loads(answer.stdout)


def weald_run(program, trees):
    command = [program, "bench", "--only", "plants", "--size", str(trees)]
    figure = report([*command, "--repeat", "1", "--threads", "1", "--json"])["figures"][0]
    return {**figure, "triangles": figure["result"]}


def ez_tree_run(folder, preset, trees):
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "trees.mjs")
    return report(["node", script, folder, preset, str(trees)])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--node", required=True, help="folder for node_modules")
    parser.add_argument("--weald", default="target/release/weald")
    parser.add_argument("--trees", type=int, default=100, help="trees in a run")
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    has_peer = installed(arguments.node)
    runs = {}
    for _ in range(arguments.repeat):
        runs.setdefault("weald aspen", []).append(weald_run(arguments.weald, arguments.trees))
        for preset in PRESETS if has_peer else []:
            found = ez_tree_run(arguments.node, preset, arguments.trees)
            runs.setdefault(f"ez-tree {preset}", []).append(found)
    print(f"{arguments.trees} trees, medians of {arguments.repeat}, CPU seconds")
    print(f"{'':<24}{'ms a tree':>12}{'triangles':>12}{'M triangles/s':>16}")
    for name, found in runs.items():
        cpu = statistics.median(run["cpu_seconds"] for run in found)
        triangles = found[0]["triangles"]
        each = triangles / arguments.trees
        print(f"{name:<24}{cpu / arguments.trees * 1e3:>12.2f}{each:>12.0f}{triangles / cpu / 1e6:>16.2f}")
    sys.exit(0 if all(run["triangles"] > 0 for found in runs.values() for run in found) else 1)


if __name__ == "__main__":
    main()
