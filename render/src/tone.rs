//! From radiance to a preview that looks like a photograph of the day.
//!
//! Exposure follows the log-average luminance of the picture [Reinhard02] §3.1. The curve is a
//! rational fit of film's response [Hill15]. Applied to each channel it bleaches a blue sky to
//! white, applied to luminance alone it leaves bright colours garish, so the two are mixed. Then
//! comes the sRGB transfer function [IEC61966].

use weald_contract::Picture;

/// Luminance to which the log average is brought. Film's response needs more than the 18 % of a
/// grey card; chosen by eye on sunlit woods and meadows.
const KEY: f64 = 0.32;

/// Part of the curve that is applied to each channel; the rest keeps hue and saturation.
const BLEACH: f32 = 0.4;

/// Gain of colour differences before the curve, which takes some away; chosen by eye.
const SATURATION: f32 = 1.1;

/// sRGB bytes of a picture's `R`, `G`, `B`, three a pixel, top row first.
///
/// `exposure_stops` brightens the automatic exposure. A channel that is missing counts as black,
/// and a value that is no number as 0.
pub fn tone_map(picture: &Picture, exposure_stops: f32) -> Vec<u8> {
    let empty = Vec::new();
    let channel = |name: &str| picture.channel(name).unwrap_or(&empty);
    let (red, green, blue) = (channel("R"), channel("G"), channel("B"));
    let at = |values: &[f32], index: usize| {
        values.get(index).copied().filter(|value| value.is_finite()).unwrap_or(0.0).max(0.0)
    };
    let pixels: Vec<[f32; 3]> = (0..picture.width * picture.height)
        .map(|index| [at(red, index), at(green, index), at(blue, index)])
        .collect();
    let scale = automatic_exposure(&pixels) * libm::exp2f(exposure_stops);
    let encode = |linear: f32| (srgb(linear) * 255.0 + 0.5) as u8;
    pixels.into_iter().flat_map(|rgb| develop(rgb.map(|c| c * scale)).map(encode)).collect()
}

/// Exposed light to display light in [0, 1].
fn develop(rgb: [f32; 3]) -> [f32; 3] {
    let grey = luminance(rgb);
    if grey <= 0.0 {
        return [0.0; 3];
    }
    let gain = filmic(grey) / grey;
    rgb.map(|channel| {
        let vivid = (grey + SATURATION * (channel - grey)).max(0.0);
        let mixed = BLEACH * filmic(vivid) + (1.0 - BLEACH) * gain * vivid;
        mixed.clamp(0.0, 1.0)
    })
}

/// Weights of red, green and blue in the luminance of linear Rec. 709.
pub(crate) const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Relative luminance of linear Rec. 709.
pub(crate) fn luminance(rgb: [f32; 3]) -> f32 {
    LUMINANCE[0] * rgb[0] + LUMINANCE[1] * rgb[1] + LUMINANCE[2] * rgb[2]
}

/// Factor that brings the log-average luminance to [`KEY`]; 1 for a black picture.
fn automatic_exposure(pixels: &[[f32; 3]]) -> f32 {
    // Black pixels say nothing about the light and would drag the logarithm to minus infinity.
    let (mut sum, mut count) = (0.0, 0u64);
    for y in pixels.iter().map(|&rgb| f64::from(luminance(rgb))).filter(|&y| y > 1e-6) {
        sum += libm::log(y);
        count += 1;
    }
    if count == 0 { 1.0 } else { (KEY / libm::exp(sum / count as f64)) as f32 }
}

/// Film's response to light: toe, straight middle and shoulder, as fitted by [Hill15].
fn filmic(linear: f32) -> f32 {
    let response = (linear * (linear + 0.024_578_6) - 0.000_090_537)
        / (linear * (0.983_729 * linear + 0.432_951) + 0.238_081);
    response.clamp(0.0, 1.0)
}

/// The sRGB transfer function.
fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Picture {
        let mut picture = Picture::new(values.len(), 1);
        for name in ["R", "G", "B"] {
            picture.add(name, false, values.to_vec());
        }
        picture
    }

    #[test]
    fn exposure_makes_the_bytes_independent_of_the_unit_of_light() {
        let values = [0.1, 0.2, 0.7, 1.0];
        let brighter: Vec<f32> = values.iter().map(|value| value * 1024.0).collect();
        assert_eq!(tone_map(&grey(&values), 0.0), tone_map(&grey(&brighter), 0.0));
    }

    #[test]
    fn more_light_never_gives_a_darker_byte() {
        let values: Vec<f32> = (0..500).map(|i| i as f32 * 0.05).collect();
        let bytes = tone_map(&grey(&values), 0.0);
        let greys: Vec<u8> = bytes.chunks(3).map(|pixel| pixel[0]).collect();
        assert!(greys.windows(2).all(|pair| pair[0] <= pair[1]));
    }

    #[test]
    fn odd_pictures_give_bytes_and_no_panic() {
        assert_eq!(tone_map(&Picture::default(), 0.0), Vec::<u8>::new());
        let bytes = tone_map(&grey(&[f32::NAN, f32::INFINITY, -1.0, 0.0]), 3.0);
        assert_eq!(bytes.len(), 12);
    }

    #[test]
    fn srgb_meets_the_published_points() {
        // IEC 61966-2-1: linear 0.5 is encoded as 0.735357.
        assert!((srgb(0.5) - 0.735_357).abs() < 1e-5);
        assert_eq!((srgb(0.0), (srgb(1.0) * 255.0 + 0.5) as u8), (0.0, 255));
    }
}
