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
            text, species = species, self.folder / f"{self.count}.toml"
            species.write_text(text)
        picture = self.folder / f"{self.count}.png"
        look = ["--schematic"] if schematic else ["--samples", "0"]
        command = [self.weald, "plants", species, "--age", str(age), *look, "--side", "512", "-q"]
        subprocess.run([*command, *options, "-o", picture], check=True)
        drawn = Image.open(picture).convert("RGB")
        return drawn.crop((0, 0, 512, 512 - 12)) if schematic else drawn


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


PICTURES = {"a-o": table_2}

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        studio = Studio(sys.argv[1], pathlib.Path(folder))
        for name in sys.argv[2:] or PICTURES:
            PICTURES[name](studio)
