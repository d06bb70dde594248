//! Difference of an image from its background, in which a shadow counts little.

use super::station::{Background, Pixels};

/// Weight of a change of brightness alone, such as a shadow.
const LIGHT_WEIGHT: f32 = 0.5;
/// Range of brightness factors of a shadow or a reflection; the excess counts whole.
const LIGHT: [f32; 2] = [0.5, 1.1];

/// `[H, W]`, distances of an image's colours from the background's, in `[0, 1]`.
///
/// A colour is split into the background's times a factor, the light, and a rest.
pub(super) fn differences(pixels: &Pixels, background: &Background) -> Vec<f32> {
    let difference = |(pixel, behind): (&[u8; 3], &[f32; 3])| {
        let seen = pixel.map(|value| f32::from(value) / 255.0);
        let light = tcgs_core::dot(*behind, seen) / tcgs_core::dot(*behind, *behind).max(1e-4);
        let light = light.clamp(LIGHT[0], LIGHT[1]);
        let rest = (0..3).map(|i| (seen[i] - light * behind[i]).abs()).fold(0.0, f32::max);
        let of_light = (1.0 - light).abs() * behind.iter().copied().fold(0.0, f32::max);
        rest + LIGHT_WEIGHT * of_light
    };
    pixels.iter().zip(&background.colors).map(difference).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shadow_is_nearer_than_a_thing() {
        let behind = Background { colors: vec![[0.6, 0.5, 0.4]; 4], known: vec![true; 4] };
        let seen = [[153, 128, 102], [145, 121, 97], [145, 128, 120], [40, 40, 40]].to_vec();
        let [same, shadow, other_hue, dark] = differences(&seen, &behind)[..] else { panic!() };
        assert!(same < 0.004 && shadow < 0.03 && other_hue > 0.05 && dark > 0.15, "{same} {shadow} {other_hue} {dark}");
    }
}
