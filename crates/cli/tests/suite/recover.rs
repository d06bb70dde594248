//! Files that were cut: refused with the advice to recover them, and read as far as they are whole.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::*;
use tcgs_codec::{Archive, Cohort, DecodeLimits, Opening, decode, encode};
use tcgs_interchange::{ReadSettings, read_ply};
use tempfile::{TempDir, tempdir};

/// A file of four frames in segments of one timestep, of two layers.
fn scene(folder: &TempDir) -> PathBuf {
    let run = train(folder, "run", &["--preset", "d3dgs"]);
    let file = folder.path().join("scene.tcgs");
    succeed(&["compress", text(&run), "--out", text(&file), "--segment-length", "1", "--refine", "off"]);
    let mut scene = decode(&fs::read(&file).unwrap(), &DecodeLimits::default()).unwrap();
    scene.layers = vec![100, scene.info.num_gaussians - 100];
    fs::write(&file, encode(&scene).unwrap()).unwrap();
    file
}

/// The only cohort of a file.
fn cohort(file: &[u8]) -> Cohort {
    match Archive::open(file, &DecodeLimits::default()).unwrap() {
        Opening::Ready(mut archive) => archive.open_cohort(0, &[]).unwrap(),
        Opening::More(_) => panic!("a whole file was given"),
    }
}

/// The first bytes of a file.
fn cut(file: &Path, length: u64) -> PathBuf {
    let path = file.with_file_name(format!("cut_{length}.tcgs"));
    fs::write(&path, &fs::read(file).unwrap()[..length as usize]).unwrap();
    path
}

/// The standard error of a command about a file that was cut.
fn warning(arguments: &[&str]) -> String {
    let output = run(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{arguments:?}: {said}");
    said.lines().find(|line| line.starts_with("warning: ")).unwrap_or_else(|| panic!("{arguments:?}: {said}")).into()
}

#[test]
fn what_is_whole_of_a_cut_file_is_read() {
    let folder = tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let file = scene(&folder);
    let bytes = fs::read(&file).unwrap();
    let cohort = cohort(&bytes);
    let (all, layers) = (cohort.num_gaussians(), cohort.num_layers());
    assert_eq!((cohort.num_segments(), layers), (4, 2));
    succeed(&["export", text(&file), "--to", text(&place("whole"))]);

    // Cut in the fourth segment: three timesteps are whole.
    let three = cut(&file, cohort.segment_range(3, layers).end - 1);
    let message = fail(2, &["export", text(&three), "--to", text(&place("no"))]);
    assert!(
        message.contains("the file ends early") && message.ends_with("; --recover reads what is whole"),
        "{message}"
    );
    assert!(!place("no").exists());
    let said = warning(&["export", text(&three), "--recover", "--to", text(&place("three"))]);
    let length = bytes.len();
    let counts = format!("3 of 4 timesteps and {all} of {all} Gaussians are whole");
    assert_eq!(
        said,
        format!("warning: {}: the file was cut at {} of {length} bytes: {counts}", text(&three), length - 1)
    );
    let mut names: Vec<_> = fs::read_dir(place("three")).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names.len(), 3);
    for name in &names {
        assert_eq!(fs::read(place("three").join(name)).unwrap(), fs::read(place("whole").join(name)).unwrap());
    }
    // The other commands.
    for command in ["info", "eval", "render"] {
        let capture = text(capture());
        let (out, refused) = (place(command), place("refused"));
        let more: &[&str] = match command {
            "eval" => &["--capture", capture, "--backend", "cpu"],
            "render" => &["--out", text(&out), "--size", "32x24", "--backend", "cpu"],
            _ => &[],
        };
        let arguments = [&[command, text(&three)], more].concat();
        let message = fail(2, &arguments);
        assert!(message.ends_with("; --recover reads what is whole"), "{message}");
        assert!(!refused.exists());
        assert_eq!(warning(&[&arguments[..], &["--recover"]].concat()), said);
    }
    assert_eq!(fs::read_dir(place("render")).unwrap().count(), 3);
    let table = succeed(&["info", text(&three), "--recover"]);
    let parts: Vec<&str> = table.lines().filter(|line| line.starts_with("frames ")).collect();
    assert!(parts[..3].iter().all(|line| line.ends_with("right")) && parts[3].contains("missing"), "{table}");
    // With a whole file the option changes nothing.
    let output = run(&["info", text(&file), "--recover"]);
    assert_eq!(String::from_utf8(output.stderr).unwrap(), "");

    // Cut in the second layer of the first segment: one timestep with the first layer is left.
    let one = cut(&file, cohort.segment_range(0, layers).end - 1);
    let first_layer = cohort.layers()[0];
    let said = warning(&["export", text(&one), "--recover", "--to", text(&place("one.ply"))]);
    assert!(said.ends_with(&format!("1 of 4 timesteps and {first_layer} of {all} Gaussians are whole")), "{said}");
    let left = read_ply(&place("one.ply"), ReadSettings::default()).unwrap();
    let name = names[0].to_str().unwrap();
    let whole = read_ply(&place("whole").join(name), ReadSettings::default()).unwrap();
    assert_eq!(left, whole.select(&(0..first_layer as usize).collect::<Vec<_>>()));

    // Cut before the end of the first segment's first layer, and in the table of contents: nothing is left.
    for length in [cohort.segment_range(0, 1).end - 1, 100] {
        let nothing = cut(&file, length);
        let message = fail(2, &["export", text(&nothing), "--recover", "--to", text(&place("no"))]);
        assert!(message.ends_with("the file ends early, expected a whole .tcgs file"), "{message}");
    }
    // The option does not apply to other damage.
    let mut damaged = bytes;
    *damaged.last_mut().unwrap() ^= 1;
    let file = place("damaged.tcgs");
    fs::write(&file, damaged).unwrap();
    let message = fail(2, &["info", text(&file), "--recover"]);
    assert!(message.contains("the checksum of") && !message.contains("--recover"), "{message}");
}
