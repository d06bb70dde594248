//! LPIPS against values that another program computed with the same weights.

use std::path::Path;

use crate::skip;
use tcgs_core::Image;
use tcgs_metrics::{Backbone, InputRange, Lpips, Protocol};

const GOLDEN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/golden");

/// The weights; `None` where `TCGS_LPIPS_WEIGHTS` names none and `REQUIRE_GOLDEN` does not ask for them.
fn weights() -> Option<Lpips> {
    let Some(path) = std::env::var_os("TCGS_LPIPS_WEIGHTS").filter(|path| !path.is_empty()) else {
        skip("TCGS_LPIPS_WEIGHTS names no file; scripts/fetch_lpips_weights.py makes one");
        return None;
    };
    Some(Lpips::read(Path::new(&path)).unwrap())
}

fn image(path: &Path) -> Image {
    let decoded = image::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())).to_rgb8();
    Image::from_rgb8(decoded.width() as usize, decoded.height() as usize, &decoded)
}

#[test]
fn published_pairs_match() {
    let list = Path::new(GOLDEN).join("lpips.json");
    if !list.exists() {
        return skip(&format!("no {}", list.display()));
    }
    let Some(lpips) = weights() else { return };
    let list: serde_json::Value = serde_json::from_slice(&std::fs::read(list).unwrap()).unwrap();
    let pairs = list["pairs"].as_array().unwrap();
    assert_eq!(pairs.len(), 4);
    for pair in pairs {
        let name = |side: &str| pair[side].as_str().unwrap();
        let [a, b] = ["a", "b"].map(|side| image(&Path::new(GOLDEN).join(name(side))));
        // Values are given to 5e-6. Decoders of JPEG round differently, by a level here and there.
        let tolerance = if name("a").ends_with(".png") { 1e-5 } else { 1e-3 };
        for backbone in Backbone::ALL {
            let expected = pair[backbone.name()].as_f64().unwrap();
            let found = lpips.distance(backbone, InputRange::Signed, &a, &b).unwrap();
            let error = (found - expected).abs();
            println!("{} {} {}: {found:.6}, off by {error:.1e}", name("a"), name("b"), backbone.name());
            assert!(error < tolerance, "{} and {}, {backbone:?}: {found}, expected {expected}", name("a"), name("b"));
        }
    }
}

/// Waves that no two rows or columns share.
fn pattern(width: usize, height: usize, phase: f32) -> Image {
    let mut image = Image::filled(width, height, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        *value = 0.5 + 0.4 * (x * 0.31 + phase).sin() * (y * 0.17 - phase).cos();
    }
    image
}

#[test]
fn the_metric_behaves() {
    let Some(lpips) = weights() else { return };
    let (a, b) = (pattern(67, 45, 0.0), pattern(67, 45, 0.7));
    for backbone in Backbone::ALL {
        let distance = |range, a: &Image, b: &Image| lpips.distance(backbone, range, a, b).unwrap();
        let there = distance(InputRange::Signed, &a, &b);
        assert_eq!(distance(InputRange::Signed, &a, &a), 0.0);
        assert!((there - distance(InputRange::Signed, &b, &a)).abs() < 1e-12 && there > 0.01, "{there}");
        // Definition of the unit range: the network gets the same pixels.
        let signed_of = |image: &Image| Image { data: image.data.iter().map(|x| (x + 1.0) / 2.0).collect(), ..*image };
        let unit = distance(InputRange::Unit, &a, &b);
        assert!((unit - distance(InputRange::Signed, &signed_of(&a), &signed_of(&b))).abs() < 1e-5);
        assert!((unit - there).abs() > 1e-3, "{backbone:?}: another metric");
        let pool = |num_threads| rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        let run = |num_threads| pool(num_threads).install(|| distance(InputRange::Signed, &a, &b));
        assert_eq!(run(1), run(3));
    }
    let small = pattern(30, 31, 0.0);
    assert!(lpips.distance(Backbone::Alex, InputRange::Signed, &small, &small).is_none());
    assert_eq!(lpips.distance(Backbone::Vgg, InputRange::Signed, &small, &small), Some(0.0));
}

#[test]
fn protocols_take_their_network_and_their_range() {
    let Some(lpips) = weights() else { return };
    let (a, b) = (pattern(40, 35, 0.0), pattern(40, 35, 0.3));
    let of = |protocol: Protocol, key: &str| {
        let index = protocol.rules().metrics.iter().position(|metric| metric.key == key).unwrap();
        protocol.measure(&a, &b, Some(&lpips))[index].unwrap()
    };
    let unit = |backbone| lpips.distance(backbone, InputRange::Unit, &a, &b).unwrap();
    assert_eq!(of(Protocol::Tc3dgs, "lpips"), unit(Backbone::Vgg));
    assert_eq!(of(Protocol::Stg, "lpips"), unit(Backbone::Alex));
    assert_eq!(of(Protocol::Stg, "lpips_vgg"), unit(Backbone::Vgg));
    // Rounded to 8 bits first.
    let rounded = of(Protocol::FourDgs, "lpips_vgg");
    assert!(rounded != unit(Backbone::Vgg) && (rounded - unit(Backbone::Vgg)).abs() < 1e-3, "{rounded}");
}

#[test]
fn other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let read = |bytes: &[u8]| {
        let path = folder.path().join("weights");
        std::fs::write(&path, bytes).unwrap();
        Lpips::read(&path).err().unwrap().to_string()
    };
    let with_header =
        |header: &str, data: &[u8]| [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), data].concat();
    assert!(read(b"no weights").contains("not safetensors"));
    assert!(read(&with_header("{}", b"")).contains("has no tensor vgg.conv0.kernel, expected LPIPS weights"));
    let tensor = r#"{"vgg.conv0.kernel":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}"#;
    assert!(
        read(&with_header(tensor, &[0; 8])).contains("vgg.conv0.kernel is F32 [2] where F32 [3, 3, 3, 64] belongs")
    );
    let missing = Lpips::read(Path::new("nowhere.safetensors")).err().unwrap().to_string();
    assert!(missing.contains("nowhere.safetensors") && missing.contains("expected LPIPS weights"), "{missing}");
}
