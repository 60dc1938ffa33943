#!/usr/bin/env python3
"""Draws the pictures of docs/growing-trees.md.

    pip install pillow
    python docs/images/growing.py target/release/weald [NAME...]
"""
import pathlib
import subprocess
import sys
import tempfile

from PIL import Image, ImageDraw

HERE = pathlib.Path(__file__).resolve().parent
SPECIES = HERE.parent.parent / "scenes" / "species" / "irregular"
SIDE = 280
# Processor seconds of `weald bench --only plants --threads 1`, and the paper's of 2012.
SECONDS = {
    "a": (0.15, 6.4), "b": (0.18, 7.0), "c": (0.35, 13.4), "d": (0.15, 5.6), "e": (0.33, 7.5),
    "f": (0.08, 3.0), "g": (0.06, 2.1), "h": (0.02, 0.7), "i": (0.10, 3.2), "j": (0.27, 9.6),
    "k": (0.09, 3.3), "l": (0.04, 1.3), "m": (0.18, 6.8), "n": (0.16, 6.7), "o": (0.13, 4.8),
}


class Studio:
    """Grows plants with `weald` and keeps their pictures."""

    def __init__(self, weald, folder):
        self.weald, self.folder, self.count = weald, folder, 0

    def draw(self, species, *options, age=300, schematic=True):
        """The picture of a species, given by file or text, without the caption below it."""
        self.count += 1
        if not isinstance(species, pathlib.Path):
            # All have one name, on which chance depends: what differs is the form.
            text, species = species, self.folder / "tree.toml"
            species.write_text(text)
        picture = self.folder / f"{self.count}.png"
        look = ["--schematic"] if schematic else ["--samples", "0"]
        command = [self.weald, "plants", species, "--age", str(age), *look, "--side", "512", "-q"]
        subprocess.run([*command, *options, "-o", picture], check=True)
        drawn = Image.open(picture).convert("RGB")
        return drawn.crop((0, 0, 512, 500 if schematic else 512))


def sheet(name, cells, columns, side=SIDE):
    """Puts captioned pictures side by side."""
    rows = -(-len(cells) // columns)
    whole = Image.new("RGB", (columns * side, rows * (side + 18)), "white")
    draw = ImageDraw.Draw(whole)
    for index, (caption, picture) in enumerate(cells):
        x, y = index % columns * side, index // columns * (side + 18)
        picture.thumbnail((side, side), Image.LANCZOS)
        whole.paste(picture, (x + (side - picture.width) // 2, y + side - picture.height))
        draw.text((x + side / 2, y + side + 8), caption, fill=(60, 60, 60), anchor="mm")
    # Sixteen greys are enough for black branches on white.
    whole = whole.convert("L").quantize(16) if whole.convert("L").convert("RGB") == whole else whole
    whole.save(HERE / "growing" / f"{name}.png", optimize=True)


def table_2(studio):
    cells = []
    for name, (ours, theirs) in SECONDS.items():
        caption = f"{name}: {ours:.2f} s (2012: {theirs} s)"
        cells.append((caption, studio.draw(SPECIES / f"{name}.toml")))
    sheet("a-o", cells, 5)


SIZE = """
[size]
height = 10.0
rate = 0.05
crown_radius = 4.0
stem_diameter = 0.4
lifespan = 100.0
[form]
"""
MUSHROOM = """
trunk = [{ shape = "cylinder", to = [0, 0, 4], radius = 0.35 }]
crown = [{ shape = "sector", center = [0, 0, 3.8], radius = 4, half_angle_deg = 90 }]
"""
THIN = """
[[form.level]]
branches = 4
nodes = 150
repeat = 2
thickness = 0.9
[[form.level]]
branches = 5
nodes = 100
thickness = 0.8
"""


def irregular(form):
    return SIZE + 'generator = "irregular"\n' + form


def self_organizing(form):
    return SIZE + 'generator = "self_organizing"\n' + form


def row(name, grow, forms, age=300, schematic=True):
    """A picture of captioned forms of one generator."""

    def draw(studio):
        cells = [(caption, studio.draw(grow(form), age=age, schematic=schematic)) for caption, form in forms]
        sheet(name, cells, len(forms))

    return draw


def tubes(*lines):
    solids = [f'{{ shape = "tube", points = {points}, radius = 0.7 }}' for points in lines]
    return "crown = [" + ", ".join(solids) + "]\n"


FLAT = """
crown = [{ shape = "box", low = [-4, -0.25, 0], high = [4, 0.25, 8] }]
nodes = 2500
branches = 40
thickness = 0.9
"""
OUTLINES = {
    "a spindle": "[[0, 2], [2.2, 3.5], [1.6, 6], [0, 11]]",
    "an hourglass": "[[0, 2], [2.4, 3], [0.6, 5.5], [2.6, 9], [0, 10]]",
    "a parasol": "[[0.3, 6], [4, 6.2], [3.4, 7.6], [0, 8.6]]",
}
WILLOW = """
shell = 1.5
branches = 14
nodes = 6000
radius = 1.5
shrink = 0.92
thickness = 1.1
[[form.level]]
branches = 2
nodes = 120
half_angle_deg = 40
rotate_deg = {turn}
thickness = 0.95
[[form.level]]
branches = 1
repeat = 5
nodes = 120
half_angle_deg = 40
rotate_deg = {turn}
thickness = 0.9
"""
LEVELS = "[[form.level]]\nbranches = 4\nrepeat = {repeat}\nnodes = 150\nthickness = 0.85\n"
LIVES = "[[form.level]]\nbranches = 4\nrepeat = 4\nnodes = 90\nthickness = 0.9\n"
LIGHT = MUSHROOM + "shell = 2\nbranches = 30\nnodes = 6000\nradius = 1.5\nthickness = 1.0\n"
LIT = "[form.light]\ntoward = [1, 0, 0.3]\n"
LIT_LEVEL = "[[form.level]]\nbranches = 5\nrepeat = 3\nnodes = 90\nthickness = 0.9\n"
SPACED = MUSHROOM + "spacing = 0.35\nnodes = 33000\nbranches = 1500\nthickness = 0.9\nshell = 1.5\n"
ROOTS = "[form.roots]\nradius = 3.5\nlaterals = {laterals}\ntaproots = {taproots}\n"
ROOT_LEVEL = "[[form.roots.level]]\nbranches = 4\nnodes = 100\nrepeat = 2\nthickness = 0.8\n"
FULL = MUSHROOM + "branches = 30\nnodes = 6000\nradius = 1.3\nthickness = 1.0\n"
CROOKED = MUSHROOM + "branches = 60\nnodes = 6000\nthickness = 0.9\n"
BALLS = MUSHROOM + "branches = 36\nnodes = 8000\nradius = 0.9\nthickness = 1.0\n"
ROOTED = MUSHROOM + "leaf = { count = 0 }\nbranches = 12\nthickness = 1.0\nradius = 1.5\n" + THIN
HANDS = """
branches = 0
endpoints = [[5, 0, 4.5], [-1.5, 0, 5.5], [3, 0, 7], [4, 0.3, 4.2], [0, 0.2, 4.6]]
nodes = 3000
radius = 1.3
thickness = 1.0
"""

IRREGULAR = {
    "graphs": [
        ("lattice, equal weights", FLAT + 'layout = "lattice"\nirregularity = 0\n'),
        ("lattice, random weights", FLAT + 'layout = "lattice"\n'),
        ("nodes by chance", FLAT),
    ],
    "weights": [(f"irregularity {power}", CROOKED + f"irregularity = {power}\n") for power in (0, 1, 4)]
    + [("guide 3, upwards", CROOKED + "guide = 3\n")],
    "links": [
        ("Yao graph", SPACED),
        ("threshold 1.6", SPACED + 'links = "threshold"\nlink = 1.6\n'),
        ("threshold 1.25", SPACED + 'links = "threshold"\nlink = 1.25\n'),
    ],
    "levels": [
        (
            f"{more + 1} levels" if more else "1 level",
            MUSHROOM + "branches = 12\nnodes = 5000\nradius = 1.8\nthickness = 0.9\n"
            + (LEVELS.format(repeat=more) if more else ""),
        )
        for more in range(4)
    ],
    "shells": [(f"shell {depth}", FULL + f"shell = {depth}\n" + THIN) for depth in (3.5, 0.4)],
    "refine": [
        ("one volume", BALLS + THIN),
        ("nine balls", BALLS + "refine = { count = 9, radius = 1.1 }\n" + THIN),
    ],
    "sketch": [
        (
            name,
            'trunk = [{ shape = "cylinder", to = [0, 0, 6.2], radius = 0.3 }]\n'
            f'crown = [{{ shape = "revolution", outline = {outline} }}]\n'
            "branches = 50\nnodes = 9000\nradius = 0.8\nthickness = 1.0\n" + THIN,
        )
        for name, outline in OUTLINES.items()
    ],
    "shrink": [
        (f"shrink {a}", MUSHROOM + "branches = 12\nnodes = 5000\nradius = 1.5\nthickness = 1.0\n"
         f"shell = 2\nshrink = {a}\n" + THIN)
        for a in (0.7, 1.0)
    ],
    "rotation": [
        (f"{turn} degrees a level", MUSHROOM + WILLOW.format(turn=turn)) for turn in (-22, 0, 15)
    ],
    "lifespan": [
        ("by one", FULL.replace("30", "14") + LIVES),
        ("by chance", FULL.replace("30", "14") + LIVES + '[form.lifespan]\naging = "random"\nfirst = 7\n'),
    ],
    "light": [
        ("no light", LIGHT + LIT_LEVEL),
        ("more branches", LIGHT + LIT + "branches = [0.1, 2.0]\n" + LIT_LEVEL),
        ("longer life", LIGHT + LIT + "loss = [1, 4]\n" + LIT_LEVEL),
    ],
    "roots": [
        ("one taproot, 40 laterals", ROOTED + ROOTS.format(laterals=40, taproots=1) + ROOT_LEVEL),
        ("nine taproots, 30 laterals", ROOTED + ROOTS.format(laterals=30, taproots=9) + ROOT_LEVEL),
    ],
    "by-hand": [
        (
            "endpoints placed by hand",
            'trunk = [{ shape = "cylinder", to = [2.5, 0, 3.2], radius = 0.4 }]\n'
            + tubes("[[2, 0, 3], [5, 0, 4.5]]", "[[2, 0, 3], [-1.5, 0, 5.5]]", "[[2.2, 0, 3], [3, 0, 7]]")
            + HANDS + THIN,
        ),
        (
            "a wall on the left",
            FULL + 'obstacle = [{ shape = "box", low = [-50, -50, -1], high = [-0.8, 50, 50] }]\n' + THIN,
        ),
    ],
}

SPACE = """
competition = "markers"
shed_after = 3
markers = { count = 6000, space = [
    { shape = "ball", center = [0, 0, 14], radius = 12 },
    { shape = "cylinder", to = [0, 0, 6], radius = 2 },
] }
"""
FEW = "alpha = [0.8, 0.8]\nlongest_shoot = 3\n"
ORGANIZING = {
    "lambda": [(f"lambda {x}", f"lambda = {x}\n") for x in (0.46, 0.48, 0.5, 0.54, 0.6)],
    "tropism": [(f"tropism {x}", f"tropism = {x}\n") for x in (-0.3, 0.0, 0.3)],
    "shedding": [(f"shed {x}", f"lambda = 0.52\nshed = {x}\n") for x in (0, 0.05, 0.2)],
    "combinations": [
        ("light, Borchert-Honda", "shed = 0.05\n"),
        ("light, priority", 'fate = "priority"\nshed = 0.05\nalpha = [1.0, 1.3]\n'),
        ("space, Borchert-Honda", SPACE),
        ("space, priority", SPACE + FEW + 'fate = "priority"\npriority = { least = 0.02 }\n'),
    ],
    "walls": [
        ("alone", ""),
        ("a wall", "script = 'at 0 obstacle box -5,-40,-1 -2,40,60 opaque'\n"),
        ("a neighbour's crown", "script = 'at 0 obstacle ball 10,0,14 8 opaque'\n"),
        ("light from the right", "script = 'at 0 light 1,0,1.5'\n"),
    ],
    "brush": [
        ("three balls", """
competition = "markers"
markers = { count = 0 }
branch_angle_deg = 75
seek = 1.0
lambda = 0.48
tropism = 0.0
script = '''
at 0 brush add ball 0,0,9 8 markers 9000
at 6 brush add ball 0,0,22 6 markers 6000
at 11 brush add ball 0,0,31 4 markers 3000
'''
"""),
        ("a stroke", """
competition = "markers"
markers = { count = 0 }
script = '''
at 0 brush add tube 0,0,0 0,0,10 9,0,18 2,0,26 -8,0,30 radius 3 markers 14000
'''
"""),
        ("a hedge", "script = 'every 1 prune outside box -7,-7,-1 7,7,16'\n"),
    ],
}
LIFE = "lambda = [[0, 0.56], [12, 0.52], [20, 0.48]]\ntropism = [[0, 0.2], [20, -0.1]]\n"


def ages(studio):
    """One tree through its life, at one scale."""
    cells = [(f"{age} years", studio.draw(self_organizing(LIFE), age=age)) for age in (5, 9, 13, 17, 22)]
    sheet("ages", cells, 5)


PICTURES = {"a-o": table_2, "ages": ages}
PICTURES |= {name: row(name, irregular, forms) for name, forms in IRREGULAR.items()}
PICTURES["roots"] = row("roots", irregular, IRREGULAR["roots"], schematic=False)
PICTURES |= {name: row(name, self_organizing, forms, age=18) for name, forms in ORGANIZING.items()}

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        studio = Studio(sys.argv[1], pathlib.Path(folder))
        for name in sys.argv[2:] or PICTURES:
            PICTURES[name](studio)
