use super::*;

fn png(width: u32, height: u32) -> Vec<u8> {
    let pixels: Vec<u8> =
        (0..width * height).flat_map(|i| [(i % width * 2) as u8, (i / width * 2) as u8, 120]).collect();
    let mut bytes = Cursor::new(Vec::new());
    image::write_buffer_with_format(&mut bytes, &pixels, width, height, image::ColorType::Rgb8, ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}

fn series(name: &str, values: impl IntoIterator<Item = f64>) -> Series {
    Series { name: name.into(), values: values.into_iter().collect() }
}

fn sample() -> Report {
    let stage = |name: &str, bytes, psnr, ssim| CompressionStep { name: name.into(), bytes, psnr, ssim };
    let bell =
        |len: usize, at: f64, size: f64| (0..len).map(move |i| (size * (-(i as f64 - at).powi(2) / 8.0).exp()).round());
    Report {
        title: "tcgs demo: a ball, a cube & a <spinner>".into(),
        summary: [
            ("Size", "142 kB"),
            ("Smaller by", "60.2×"),
            ("PSNR, test cameras", "28.41 dB"),
            ("Moving objects", "25.10 dB"),
            ("Were they frozen", "14.92 dB"),
            ("SSIM", "0.9132"),
            ("Gaussians", "7214"),
            ("Time", "48 s"),
        ]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .into(),
        stages: vec![
            stage("trained", 7_808_000, Some(28.61), Some(0.9150)),
            stage("pruned", 6_950_000, Some(28.60), Some(0.9149)),
            stage("quantised", 2_310_000, Some(28.52), None),
            stage("keypoints", 412_000, Some(28.44), Some(0.9135)),
            stage("file", 142_300, Some(28.41), Some(0.9132)),
        ],
        seconds: [
            ("capture", 1.0),
            ("first timestep", 14.2),
            ("later timesteps", 27.5),
            ("compression", 1.9),
            ("evaluation", 3.3),
        ]
        .map(|(name, secs)| (name.to_owned(), secs))
        .into(),
        loss: (0..4000)
            .map(|i| (i, 0.02 + 0.35 * (-(i as f32) / 180.0).exp() + 0.004 * ((i * 37 % 17) as f32 / 17.0)))
            .collect(),
        psnr_over_time: vec![
            series("trained", (0..24).map(|i| 28.9 - 0.02 * f64::from(i) + 0.1 * f64::from(i).sin())),
            series("file", (0..24).map(|i| 28.6 - 0.02 * f64::from(i) + 0.1 * f64::from(i).sin())),
            series(
                "file, moving objects",
                (0..24).map(|i| if i == 7 { f64::NAN } else { 25.3 + 0.3 * (0.7 * f64::from(i)).cos() }),
            ),
        ],
        keypoints_histogram: vec![
            series("means", bell(25, 3.0, 14_000.0)),
            series("quats", bell(25, 5.0, 9_000.0)),
            series("colors", bell(25, 9.0, 11_000.0)),
        ],
        mask_histogram: (0..20).map(|i| (i as f32 / 20.0, if i == 0 { 900 } else { (i * i * 20) as u64 })).collect(),
        bits_histogram: vec![
            series("means", bell(17, 16.0, 20_000.0)),
            series("quats", bell(17, 7.0, 9_000.0)),
            series("log_scales", bell(17, 6.0, 9_000.0)),
            series("logit_opacities", bell(17, 4.0, 7_000.0)),
            series("colors", bell(17, 6.0, 12_000.0)),
        ],
        pictures: vec![
            Picture { caption: "held-out camera, timestep 12: capture".into(), png: png(128, 96) },
            Picture { caption: "the same from the file".into(), png: png(127, 96) },
            Picture { caption: "both, side by side".into(), png: png(256, 96) },
        ],
    }
}

const SECTIONS: [&str; 8] = ["Size", "Quality over time", "Training", "Time", "Keypoints", "Bits", "Masks", "Pictures"];

/// Checks that tags nest and attributes are quoted; returns the number of elements.
fn assert_well_formed(page: &str) -> usize {
    const VOID: [&str; 2] = ["meta", "img"];
    let (mut open, mut count) = (Vec::new(), 0);
    let mut rest = page.strip_prefix("<!DOCTYPE html>").unwrap();
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').unwrap();
        let tag = &rest[start + 1..end];
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap().to_owned();
        if tag.starts_with('/') {
            assert_eq!(open.pop().as_ref(), Some(&name), "closed by {tag}");
        } else {
            count += 1;
            if !tag.ends_with('/') && !VOID.contains(&name.as_str()) {
                open.push(name);
            }
        }
        rest = &rest[end + 1..];
    }
    assert!(open.is_empty(), "{open:?}");
    count
}

#[test]
fn the_page_is_well_formed_and_shows_every_section() {
    let page = html(&sample());
    assert!(assert_well_formed(&page) > 200);
    for section in SECTIONS {
        assert!(page.contains(&format!(">{section}</h2>")), "{section}");
    }
    assert!(!page.contains("Not measured"));
    assert!(page.contains("a cube &amp; a &lt;spinner&gt;</h1>"));
    // A missing number differs from 0.
    for text in ["7.81 MB", "142 kB", ">54.9<", ">28.41<", ">0.9132<", "<td>–</td>"] {
        assert!(page.contains(text), "{text}");
    }
    assert_eq!(page.matches("<polyline").count(), 4);
}

#[test]
fn nothing_comes_from_elsewhere() {
    let page = html(&sample());
    for text in ["http", "<script", "<link", "@import", "url("] {
        assert!(!page.contains(text), "{text}");
    }
}

#[test]
fn numbers_that_are_none_do_not_reach_the_page() {
    let mut report = sample();
    report.loss[5].1 = f32::NAN;
    report.seconds.push(("broken".into(), f64::INFINITY));
    report.stages.push(CompressionStep {
        name: "empty".into(),
        bytes: 0,
        psnr: Some(f64::NAN),
        ssim: Some(f64::NEG_INFINITY),
    });
    report.bits_histogram[0].values[3] = f64::NAN;
    report.psnr_over_time.push(series("nothing", [f64::NAN; 3]));
    let page = html(&report);
    assert_well_formed(&page);
    assert!(!page.contains("NaN") && !page.contains("inf"), "{:?}", page.find("NaN").or(page.find("inf")));
}

#[test]
fn an_empty_report_says_that_nothing_was_measured() {
    let page = html(&Report::default());
    assert_well_formed(&page);
    assert_eq!(page.matches("Not measured.").count(), SECTIONS.len());
    assert!(!page.contains("NaN") && !page.contains("inf"));
}

#[test]
fn pictures_survive_as_data_uris() {
    let page = html(&sample());
    let uris: Vec<&str> =
        page.split("data:image/png;base64,").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    let sizes: Vec<(u32, u32)> = uris
        .iter()
        .map(|uri| {
            let decoded = image::load_from_memory(&BASE64_STANDARD.decode(uri).unwrap()).unwrap();
            (decoded.width(), decoded.height())
        })
        .collect();
    assert_eq!(sizes, [(128, 96), (127, 96), (256, 96)]);
    assert_eq!(page.matches("<figure class=\"wide\">").count(), 1);
}
