//! Cases that random and realistic scenes do not reach: models of age 256, ties, clamps, overflow.

use tcgs_codec::{BitMap, ColorSpace, CompactScene, Quantizer, Quantizers, SceneInfo, Tracks, UpAxis};
use tcgs_core::{Attribute, Layout};

use super::any_scene::Numbers;

/// Times and codes of one track.
type Track = (Vec<u16>, Vec<i16>);

/// A scene under construction: every width is 4 bits, every step 1/8, every track constant with code 0.
struct Draft {
    scene: CompactScene,
    tracks: [Vec<Track>; 5],
}

impl Draft {
    fn new(num_gaussians: usize, num_timesteps: u32) -> Self {
        let info = SceneInfo {
            num_gaussians: num_gaussians as u32,
            num_timesteps,
            first_frame: 0,
            frame_rate: 30.0,
            downscale: 1,
            name: String::new(),
            generator: "vectors".into(),
            color_space: ColorSpace::Srgb,
            up: UpAxis::MinusY,
        };
        let scene = CompactScene {
            info,
            start: 0,
            lives: None,
            bit_map: BitMap::uniform(num_gaussians, 4, 4),
            quantizers: Quantizers::default(),
            varies: vec![false; 5],
            layers: vec![num_gaussians as u32],
            segment_length: 65_536,
            tracks: vec![],
            layout: Layout::base(),
        };
        let tracks = Attribute::BASE.map(|a| vec![(vec![0], vec![0]); num_gaussians * a.components()]);
        let mut draft = Self { scene, tracks };
        Attribute::BASE.into_iter().for_each(|a| draft.quantize(a, 4, 0.125, 0.0));
        draft
    }

    /// Adds the quantizers of a width.
    fn quantize(&mut self, attribute: Attribute, width: u8, step: f32, offset: f32) {
        let quantizer = Quantizer::new(step, offset, width).unwrap();
        self.scene.quantizers.attributes[attribute.index()].insert(width, vec![quantizer; attribute.components()]);
    }

    fn set_width(&mut self, attribute: Attribute, gaussian: usize, width: u8) {
        self.scene.bit_map.widths[attribute.index()][gaussian] = width;
    }

    /// Sets codes of all components of a Gaussian at the same times.
    ///
    /// - `codes`: `[keypoints][components]`
    fn set(&mut self, attribute: Attribute, gaussian: usize, times: &[u16], codes: &[&[i16]]) {
        let components = attribute.components();
        for c in 0..components {
            let of_component = codes.iter().map(|row| row[c]).collect();
            self.tracks[attribute.index()][gaussian * components + c] = (times.to_vec(), of_component);
        }
        self.scene.varies[attribute.index()] |= times.len() > 1;
    }

    fn finish(mut self) -> CompactScene {
        self.scene.tracks = self
            .tracks
            .iter()
            .map(|of_attribute| {
                let mut tracks = Tracks::default();
                of_attribute.iter().for_each(|(times, codes)| tracks.push(times, codes));
                tracks
            })
            .collect();
        self.scene
    }
}

/// One Gaussian that fades over two timesteps: every kind of section, once.
pub fn one_gaussian() -> CompactScene {
    let mut draft = Draft::new(1, 2);
    draft.set(Attribute::Mean, 0, &[0], &[&[1, 2, 3]]);
    draft.set(Attribute::Quat, 0, &[0], &[&[7, 0, 0, 0]]);
    draft.set(Attribute::Color, 0, &[0], &[&[4, 5, 6]]);
    draft.set(Attribute::LogitOpacity, 0, &[0, 1], &[&[6], &[-7]]);
    draft.finish()
}

/// A Gaussian of 1,200 keypoints, with which models reach their slowest adaptation. Others have few or many keypoints
/// over a long time.
pub fn many_keypoints() -> CompactScene {
    let inner = [9, 20, 40, 10, 70, 25, 1198, 3, 0, 1, 2];
    let random = &mut Numbers(20);
    let mut draft = Draft::new(inner.len(), 1200);
    draft.quantize(Attribute::LogitOpacity, 2, 0.5, 0.25);
    for (gaussian, &count) in inner.iter().enumerate() {
        draft.set_width(Attribute::LogitOpacity, gaussian, 2);
        let mut times: Vec<u16> = (1..1199).collect();
        while times.len() > count {
            times.remove(random.below(times.len() as u64) as usize);
        }
        times.insert(0, 0);
        times.push(1199);
        let codes: Vec<i16> = times.iter().map(|_| random.below(4) as i16 - 2).collect();
        draft.tracks[Attribute::LogitOpacity.index()][gaussian] = (times, codes);
    }
    draft.scene.varies[Attribute::LogitOpacity.index()] = true;
    draft.finish()
}

/// Gaussians at eight points, most of which hold several: curve keys are equal and neighbours are tied. Colours of 12
/// bits are nearly grey.
pub fn crowd() -> CompactScene {
    let random = &mut Numbers(21);
    let mut draft = Draft::new(84, 1);
    draft.scene.layers = vec![40, 44];
    draft.quantize(Attribute::Color, 12, 1.0 / 2048.0, 0.5);
    for gaussian in 0..84 {
        let at: [i16; 3] = std::array::from_fn(|_| random.below(2) as i16);
        draft.set(Attribute::Mean, gaussian, &[0], &[&at]);
        draft.set_width(Attribute::Color, gaussian, 12);
        // Nearly grey: neighbours predict a colour badly, its first component predicts it well.
        let spread = 4 + random.below(9);
        let grey = random.below(1 << spread) as i16 - (1 << (spread - 1));
        let color: [i16; 3] =
            std::array::from_fn(|c| (grey - 5 * c as i16 + random.below(9) as i16).clamp(-2048, 2047));
        draft.set(Attribute::Color, gaussian, &[0], &[&color]);
        draft.set(Attribute::LogitOpacity, gaussian, &[0], &[&[random.below(16) as i16 - 8]]);
    }
    draft.finish()
}

/// A Gaussian of coarse steps among Gaussians of steps a million times finer, all moving: predictions lie far beyond
/// the range of the codes.
pub fn clamps() -> CompactScene {
    let random = &mut Numbers(22);
    let mut draft = Draft::new(12, 12);
    draft.scene.segment_length = 5;
    draft.quantize(Attribute::Color, 16, 1000.0, 0.0);
    draft.quantize(Attribute::Color, 9, 0.001, 0.0);
    let times: Vec<u16> = (0..12).collect();
    let mut any_codes = |bits: u32| -> Vec<[i16; 3]> {
        let mut code = || random.below(1 << bits) as i16 - (1 << (bits - 1));
        times.iter().map(|_| [code(), code(), code()]).collect()
    };
    let (coarse, fine) = (any_codes(15), any_codes(9));
    for gaussian in 0..12 {
        let codes: Vec<&[i16]> = if gaussian == 0 { &coarse } else { &fine }.iter().map(<[i16; 3]>::as_slice).collect();
        draft.set_width(Attribute::Color, gaussian, if gaussian == 0 { 16 } else { 9 });
        draft.set(Attribute::Color, gaussian, &times, &codes);
    }
    draft.finish()
}

/// Quaternions of length zero, of a length beyond all floats, and interpolated to their opposite; scales beyond all
/// floats, and opacities whose difference overflows a float.
pub fn beyond_floats() -> CompactScene {
    let mut draft = Draft::new(6, 5);
    for (gaussian, (width, step)) in [(5, 1e-25), (6, 1e30), (7, 3e38)].into_iter().enumerate() {
        draft.quantize(Attribute::Quat, width, step, 0.0);
        draft.set_width(Attribute::Quat, gaussian, width);
        draft.set(Attribute::Quat, gaussian, &[0], &[&[9, -3, 2, 1]]);
    }
    draft.set(Attribute::Quat, 3, &[0], &[&[0, 0, 0, 0]]);
    draft.set(Attribute::Quat, 4, &[0, 4], &[&[3, -1, 2, 0], &[-3, 1, -2, 0]]);
    draft.set(Attribute::Quat, 5, &[0, 1, 4], &[&[3, -1, 2, 1], &[2, 2, 2, 2], &[-7, 1, -2, 0]]);
    draft.quantize(Attribute::LogScale, 5, 1e38, 0.0);
    draft.set_width(Attribute::LogScale, 2, 5);
    draft.set(Attribute::LogScale, 2, &[0], &[&[-4, 3, 4]]);
    draft.quantize(Attribute::LogitOpacity, 6, 1e37, 0.0);
    draft.set_width(Attribute::LogitOpacity, 1, 6);
    draft.set(Attribute::LogitOpacity, 1, &[0, 3, 4], &[&[30], &[-30], &[1]]);
    draft.finish()
}

/// One segment for 65,536 timesteps in which nothing moves, although the segment length is 1.
pub fn still() -> CompactScene {
    let mut draft = Draft::new(1, 65_536);
    draft.scene.segment_length = 1;
    draft.set(Attribute::Color, 0, &[0], &[&[-1, 0, 1]]);
    draft.finish()
}
