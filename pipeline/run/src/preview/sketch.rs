//! A small RGB canvas: dots, lines and a few letters.

/// An sRGB picture, top row first, three bytes a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sketch {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `3 * width * height` bytes.
    pub rgb: Vec<u8>,
}

impl Sketch {
    /// A canvas of one colour.
    pub fn filled(width: usize, height: usize, color: [u8; 3]) -> Self {
        let rgb = color.iter().copied().cycle().take(3 * width * height).collect();
        Self { width, height, rgb }
    }

    /// The colour of a pixel, if it is on the canvas.
    pub fn get(&self, x: i64, y: i64) -> Option<[u8; 3]> {
        let at = self.offset(x, y)?;
        Some([self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]])
    }

    /// Mixes a colour over a pixel; outside the canvas nothing happens.
    pub fn blend(&mut self, x: i64, y: i64, color: [u8; 3], alpha: f32) {
        let Some(at) = self.offset(x, y) else { return };
        for (channel, new) in self.rgb[at..at + 3].iter_mut().zip(color) {
            let mixed = f32::from(*channel) * (1.0 - alpha) + f32::from(new) * alpha;
            *channel = mixed.round() as u8;
        }
    }

    fn offset(&self, x: i64, y: i64) -> Option<usize> {
        let inside = x >= 0 && y >= 0 && x < self.width as i64 && y < self.height as i64;
        inside.then(|| 3 * (y as usize * self.width + x as usize))
    }

    /// Draws a disc whose rim is smoothed over one pixel; tiny ones keep at least a faint dot.
    pub fn disc(&mut self, x: f64, y: f64, radius: f64, color: [u8; 3], alpha: f32) {
        let reach = radius.max(0.5) + 1.0;
        if !(x.is_finite() && y.is_finite() && reach < 1e5) {
            return;
        }
        let (left, right) = ((x - reach).floor() as i64, (x + reach).ceil() as i64);
        let (top, bottom) = ((y - reach).floor() as i64, (y + reach).ceil() as i64);
        for row in top.max(0)..=bottom.min(self.height as i64 - 1) {
            for column in left.max(0)..=right.min(self.width as i64 - 1) {
                let distance = (column as f64 + 0.5 - x).hypot(row as f64 + 0.5 - y);
                let cover = (radius.max(0.5) + 0.5 - distance).clamp(0.0, 1.0) as f32;
                if cover > 0.0 {
                    self.blend(column, row, color, cover * alpha);
                }
            }
        }
    }

    /// Draws a line about a pixel wide.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], color: [u8; 3], alpha: f32) {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        if !length.is_finite() {
            return;
        }
        // A line can leave the canvas; no canvas of ours is longer than this.
        let steps = (length.ceil() as usize).clamp(1, 100_000);
        for step in 0..=steps {
            let t = step as f64 / steps as f64;
            let x = from[0] + t * (to[0] - from[0]);
            let y = from[1] + t * (to[1] - from[1]);
            self.blend(x.floor() as i64, y.floor() as i64, color, alpha);
        }
    }

    /// Fills a rectangle.
    pub fn rectangle(
        &mut self,
        x: i64,
        y: i64,
        width: i64,
        height: i64,
        color: [u8; 3],
        alpha: f32,
    ) {
        for row in y.max(0)..(y + height).min(self.height as i64) {
            for column in x.max(0)..(x + width).min(self.width as i64) {
                self.blend(column, row, color, alpha);
            }
        }
    }

    /// Writes capital letters, digits and a few signs; others stay blank.
    ///
    /// Letters are 5 units high and 3 wide, a unit being `size` pixels. Returns the width drawn.
    pub fn text(&mut self, x: i64, y: i64, text: &str, size: i64, color: [u8; 3]) -> i64 {
        let mut left = x;
        for letter in text.chars() {
            let rows = glyph(letter.to_ascii_uppercase());
            for (row, bits) in (0i64..).zip(rows) {
                for column in (0..3i64).filter(|column| bits >> (2 - column) & 1 == 1) {
                    self.rectangle(left + column * size, y + row * size, size, size, color, 1.0);
                }
            }
            left += 4 * size;
        }
        left - x
    }

    /// Copies another sketch onto this one with its top left corner at (x, y).
    pub fn paste(&mut self, other: &Sketch, x: i64, y: i64) {
        for row in 0..other.height as i64 {
            for column in 0..other.width as i64 {
                if let Some(color) = other.get(column, row) {
                    self.blend(x + column, y + row, color, 1.0);
                }
            }
        }
    }
}

/// Five rows of three bits, drawn for legibility at small size.
fn glyph(letter: char) -> [u8; 5] {
    match letter {
        'A' => [0b010, 0b101, 0b111, 0b101, 0b101],
        'B' => [0b110, 0b101, 0b110, 0b101, 0b110],
        'C' => [0b011, 0b100, 0b100, 0b100, 0b011],
        'D' => [0b110, 0b101, 0b101, 0b101, 0b110],
        'E' => [0b111, 0b100, 0b110, 0b100, 0b111],
        'F' => [0b111, 0b100, 0b110, 0b100, 0b100],
        'G' => [0b011, 0b100, 0b101, 0b101, 0b011],
        'H' => [0b101, 0b101, 0b111, 0b101, 0b101],
        'I' => [0b111, 0b010, 0b010, 0b010, 0b111],
        'J' => [0b001, 0b001, 0b001, 0b101, 0b010],
        'K' => [0b101, 0b101, 0b110, 0b101, 0b101],
        'L' => [0b100, 0b100, 0b100, 0b100, 0b111],
        'M' => [0b101, 0b111, 0b111, 0b101, 0b101],
        'N' => [0b110, 0b101, 0b101, 0b101, 0b101],
        'O' => [0b010, 0b101, 0b101, 0b101, 0b010],
        'P' => [0b110, 0b101, 0b110, 0b100, 0b100],
        'Q' => [0b010, 0b101, 0b101, 0b110, 0b011],
        'R' => [0b110, 0b101, 0b110, 0b101, 0b101],
        'S' => [0b011, 0b100, 0b010, 0b001, 0b110],
        'T' => [0b111, 0b010, 0b010, 0b010, 0b010],
        'U' => [0b101, 0b101, 0b101, 0b101, 0b111],
        'V' => [0b101, 0b101, 0b101, 0b101, 0b010],
        'W' => [0b101, 0b101, 0b111, 0b111, 0b101],
        'X' => [0b101, 0b101, 0b010, 0b101, 0b101],
        'Y' => [0b101, 0b101, 0b010, 0b010, 0b010],
        'Z' => [0b111, 0b001, 0b010, 0b100, 0b111],
        '0' => [0b111, 0b101, 0b101, 0b101, 0b111],
        '1' => [0b010, 0b110, 0b010, 0b010, 0b111],
        '2' => [0b110, 0b001, 0b010, 0b100, 0b111],
        '3' => [0b110, 0b001, 0b010, 0b001, 0b110],
        '4' => [0b101, 0b101, 0b111, 0b001, 0b001],
        '5' => [0b111, 0b100, 0b110, 0b001, 0b110],
        '6' => [0b011, 0b100, 0b111, 0b101, 0b111],
        '7' => [0b111, 0b001, 0b010, 0b010, 0b010],
        '8' => [0b111, 0b101, 0b111, 0b101, 0b111],
        '9' => [0b111, 0b101, 0b111, 0b001, 0b110],
        '-' => [0, 0, 0b111, 0, 0],
        '_' => [0, 0, 0, 0, 0b111],
        '.' => [0, 0, 0, 0, 0b010],
        ',' => [0, 0, 0, 0b010, 0b100],
        ':' => [0, 0b010, 0, 0b010, 0],
        '/' => [0b001, 0b001, 0b010, 0b100, 0b100],
        ';' => [0, 0b010, 0, 0b010, 0b100],
        '=' => [0, 0b111, 0, 0b111, 0],
        '%' => [0b101, 0b001, 0b010, 0b100, 0b101],
        '(' => [0b001, 0b010, 0b010, 0b010, 0b001],
        ')' => [0b100, 0b010, 0b010, 0b010, 0b100],
        _ => [0; 5],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawing_outside_the_canvas_does_nothing() {
        let mut sketch = Sketch::filled(8, 4, [9, 9, 9]);
        let before = sketch.clone();
        sketch.disc(-50.0, 2.0, 3.0, [255; 3], 1.0);
        sketch.disc(f64::NAN, 2.0, 3.0, [255; 3], 1.0);
        sketch.line([-9.0, -9.0], [-1.0, -1.0], [255; 3], 1.0);
        sketch.text(100, 0, "OUT", 1, [255; 3]);
        assert_eq!(sketch, before);
        assert_eq!(sketch.get(8, 0), None);
    }

    #[test]
    fn a_disc_covers_its_area() {
        let mut sketch = Sketch::filled(64, 64, [0; 3]);
        sketch.disc(32.0, 32.0, 20.0, [255; 3], 1.0);
        let covered: f64 =
            sketch.rgb.iter().step_by(3).map(|&value| f64::from(value) / 255.0).sum();
        let area = std::f64::consts::PI * 400.0;
        assert!((covered - area).abs() < 0.02 * area, "{covered} of {area}");
    }
}
