use tcgs_core::{Attribute, Gaussians};
use tempfile::TempDir;

use super::*;
use crate::HigherHarmonics;
use crate::{write_glb_to, write_ply_to};

/// A hundred Gaussians on a crumpled sheet, and where they are at a timestep.
fn at(timestep: usize) -> Gaussians {
    let mut gaussians = Gaussians::zeros(100);
    for i in 0..100 {
        let (x, y) = ((i % 10) as f32, (i / 10) as f32);
        gaussians.means_mut()[i] = [x + 20.0 * timestep as f32, y, (0.7 * x + y).sin() + 0.1 * timestep as f32];
        gaussians.quats_mut()[i] = [1.0, 0.1 * x, 0.0, 0.0];
        gaussians.colors_mut()[i] = [0.1 * x, 0.1 * y, 0.5];
        gaussians.log_scales_mut()[i] = [-2.0, -3.0, -0.5 * x];
        gaussians.logit_opacities_mut()[i] = y - timestep as f32;
    }
    gaussians
}

fn write(folder: &TempDir, name: &str, gaussians: &Gaussians) -> PathBuf {
    let path = folder.path().join(name);
    write_ply_to(fs::File::create(&path).unwrap(), gaussians).unwrap();
    path
}

/// Reads a folder; an error is its file and its problem.
fn read(folder: &TempDir) -> Result<(DynamicGaussians, Option<u32>), (String, String)> {
    let files = TimestepFiles::open(folder.path(), ReadSettings::default());
    let read = files.and_then(|files| Ok((files.read(0..files.num_timesteps())?, files.first_frame())));
    read.map_err(|error| {
        let message = error.to_string();
        let (file, problem) = message.split_once(": ").unwrap();
        (name(Path::new(file)), problem.to_owned())
    })
}

#[test]
fn files_are_timesteps_in_natural_order() {
    let folder = tempfile::tempdir().unwrap();
    for (name, timestep) in [("frame_10.ply", 2), ("frame_9.PLY", 1), ("frame_1.ply", 0)] {
        write(&folder, name, &at(timestep));
    }
    fs::write(folder.path().join("._frame_2.ply"), "a note").unwrap();
    fs::write(folder.path().join("readme.txt"), "").unwrap();
    let (scene, first_frame) = read(&folder).unwrap();
    assert_eq!((scene.num_timesteps(), first_frame), (3, None));
    assert!(scene.varies(Attribute::LogitOpacity) && !scene.varies(Attribute::LogScale));
    for timestep in 0..3 {
        let (found, expected) = (scene.at(timestep), at(timestep));
        assert_eq!((&found.means(), &found.quats()), (&expected.means(), &expected.quats()));
        assert_eq!(
            (&found.log_scales(), &found.logit_opacities()),
            (&expected.log_scales(), &expected.logit_opacities())
        );
    }
    let one = TimestepFiles::open(&folder.path().join("frame_10.ply"), ReadSettings::default()).unwrap();
    assert_eq!((one.at(0).unwrap(), one.kind()), (scene.at(2), "PLY files"));
}

#[test]
fn numbers_that_count_up_are_frames() {
    let frames = |names: &[&str]| first_frame(&names.iter().map(PathBuf::from).collect::<Vec<_>>());
    assert_eq!(frames(&["a/000007.ply", "a/000008.ply", "a/9.ply"]), Some(7));
    assert_eq!(frames(&["0.ply"]), Some(0));
    assert_eq!(frames(&["000001.compressed.ply", "000002.compressed.ply", "3.sog"]), Some(1));
    for names in [&["1.ply", "3.ply"][..], &["f1.ply", "f2.ply"], &["+1.ply"], &["1.5.ply"], &["4294967295.ply"; 2]] {
        assert_eq!(frames(names), None, "{names:?}");
    }
}

#[test]
fn the_first_file_that_does_not_fit_is_named() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(
        read(&folder).unwrap_err().1,
        "holds no PLY, SPZ, glTF, SOG, .splat or .ksplat file, expected one a timestep"
    );
    for timestep in 0..4 {
        write(&folder, &format!("{timestep}.ply"), &at(timestep));
    }
    assert_eq!(read(&folder).unwrap().1, Some(0));

    let fewer = write(&folder, "2.ply", &at(2).select(&(0..99).collect::<Vec<_>>()));
    write(&folder, "3.ply", &Gaussians::zeros(3));
    let (file, problem) = read(&folder).unwrap_err();
    let first = folder.path().join("0.ply");
    assert_eq!(problem, format!("has 99 Gaussians, expected 100 as in {}", first.display()));
    assert_eq!(file, name(&fewer));
    write(&folder, "3.ply", &at(3));

    let mut shuffled: Vec<usize> = (0..100).map(|i| i * 37 % 100).collect();
    write(&folder, "2.ply", &at(2).select(&shuffled));
    let (file, problem) = read(&folder).unwrap_err();
    assert!(file == "2.ply" && problem.starts_with("the median Gaussian moves by 1."), "{problem}");
    // Up to now the rows were mixed; neighbours that changed places are near enough.
    shuffled = (0..100).map(|i| i ^ 1).collect();
    write(&folder, "2.ply", &at(2).select(&shuffled));
    assert_eq!(read(&folder).unwrap().0.num_timesteps(), 4);

    let mut infinite = at(1);
    infinite.log_scales_mut()[4][1] = f32::INFINITY;
    write(&folder, "1.ply", &infinite);
    let (file, problem) = read(&folder).unwrap_err();
    assert_eq!((&*file, &*problem), ("1.ply", "log_scales of Gaussian 4: inf, expected a finite number"));
}

#[test]
fn infinite_opacities_and_empty_scales_are_replaced_and_counted_once() {
    let folder = tempfile::tempdir().unwrap();
    for timestep in 0..4 {
        let mut gaussians = at(timestep);
        if timestep > 1 {
            gaussians.logit_opacities_mut()[3..5].copy_from_slice(&[f32::INFINITY, f32::NEG_INFINITY]);
            gaussians.log_scales_mut()[4] = [f32::NEG_INFINITY, 1.0, f32::NEG_INFINITY];
        }
        write(&folder, &format!("{timestep}.ply"), &gaussians);
    }
    let files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
    assert_eq!(files.notes(), []);
    for timestep in [0, 2, 2, 3] {
        files.at(timestep).unwrap();
    }
    let found = files.at(2).unwrap();
    let [opaque, clear] = [3, 4].map(|i| found.logit_opacities()[i]);
    assert!(opaque > 17.0 && clear == -opaque && tcgs_core::sigmoid(opaque) == 1.0, "{opaque} {clear}");
    let [x, y, z] = found.log_scales()[4];
    assert!(y == 1.0 && x == z && (-21.0..-19.0).contains(&x), "{x} {z}");
    let note = ReadNote::Replaced { opacities: 4, scales: 4, timesteps: 2 };
    assert_eq!(files.notes(), [note]);
    assert_eq!(
        note.to_string(),
        "infinite numbers were replaced by finite ones: opacities 4, scales 4, in 2 timesteps"
    );

    let mut wrong = at(1);
    wrong.logit_opacities_mut()[7] = f32::NAN;
    write(&folder, "1.ply", &wrong);
    let problem = files.at(1).unwrap_err().to_string();
    assert!(problem.ends_with("logit_opacities of Gaussian 7: NaN, expected a finite number"), "{problem}");
}

#[test]
fn the_number_of_gaussians_may_change_in_every_file() {
    let folder = tempfile::tempdir().unwrap();
    let numbers = [70, 100, 3, 99];
    for (timestep, n) in numbers.into_iter().enumerate() {
        write(&folder, &format!("{timestep}.ply"), &at(timestep).select(&(0..n).collect::<Vec<_>>()));
    }
    let mut files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
    assert_eq!((files.num_identities(), files.num_timesteps(), files.all_live()), (None, 4, false));
    assert_eq!([0, 1, 2, 3].map(|t| files.num_gaussians_at(t)), numbers);
    assert_eq!(files.raw_bytes(), (70 + 100 + 3 + 99) * 56);
    assert_eq!(SceneReader::at(&mut files, 2).unwrap().means(), &at(2).means()[..3]);
    let problem = files.read(1..4).unwrap_err().to_string();
    assert!(problem.contains("2.ply: has 3 Gaussians, expected 100 as in "), "{problem}");

    // A change after the headers were read is noticed.
    write(&folder, "2.ply", &at(2));
    let problem = files.at(2).unwrap_err().to_string();
    let expected = "has 100 Gaussians with spherical harmonics of degree 0, \
                    expected 3 with spherical harmonics of degree 0 as when it was opened";
    assert!(problem.ends_with(expected), "{problem}");
}

/// Gaussians with harmonics of a degree that differ from one another, and over time if wanted.
fn with_harmonics(timestep: usize, degree: usize, turns: f32) -> Gaussians {
    let mut gaussians = at(timestep).extended(&Layout::with_harmonics(degree));
    for (l, band) in gaussians.layout().harmonics().into_iter().enumerate() {
        for (i, value) in gaussians.values_mut(band).iter_mut().enumerate() {
            *value = (0.3 * i as f32 + l as f32 + turns * timestep as f32).sin();
        }
    }
    gaussians
}

#[test]
fn harmonics_are_held_once_if_they_do_not_vary() {
    let bits = |gaussians: &Gaussians, band| -> Vec<u32> {
        gaussians.values(band).iter().map(|x: &f32| x.to_bits()).collect()
    };
    for (turns, samples) in [(0.0, 1), (0.1, 3)] {
        let folder = tempfile::tempdir().unwrap();
        for timestep in 0..3 {
            write(&folder, &format!("{timestep}.ply"), &with_harmonics(timestep, 3, turns));
        }
        let scene = read(&folder).unwrap().0;
        assert_eq!(*scene.layout(), Layout::with_harmonics(3));
        for band in scene.layout().harmonics() {
            assert_eq!(scene.num_samples(band), samples);
            for timestep in 0..3 {
                assert_eq!(bits(&scene.at(timestep), band), bits(&with_harmonics(timestep, 3, turns), band));
            }
        }
        let files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
        assert_eq!(files.raw_bytes(), 100 * (40 * 3 + 16 + 180));
        let dropped = TimestepFiles::open(folder.path(), HigherHarmonics::Drop.into()).unwrap();
        assert_eq!((dropped.layout().is_base(), dropped.raw_bytes()), (true, 100 * (40 * 3 + 16)));
        assert_eq!(dropped.read(0..3).unwrap().means(2), at(2).means());
    }
}

#[test]
fn a_file_of_another_degree_is_named() {
    let folder = tempfile::tempdir().unwrap();
    for (timestep, degree) in [2, 2, 1].into_iter().enumerate() {
        write(&folder, &format!("{timestep}.ply"), &with_harmonics(timestep, degree, 0.0));
    }
    let (file, problem) = read(&folder).unwrap_err();
    let first = folder.path().join("0.ply");
    let expected = format!(
        "has spherical harmonics of degree 1, expected spherical harmonics of degree 2 as in {}",
        first.display()
    );
    assert_eq!((&*file, problem), ("2.ply", expected));
    assert!(TimestepFiles::open(folder.path(), HigherHarmonics::Drop.into()).is_ok());
}

#[test]
fn what_all_have_in_common_is_no_jump() {
    let turned = |degrees: f32| -> Vec<[f32; 3]> {
        let (sin, cos) = degrees.to_radians().sin_cos();
        at(0).means().iter().map(|&[x, y, z]| [cos * x - sin * y + 500.0, sin * x + cos * y, z - 70.0]).collect()
    };
    assert_eq!(jump(&turned(0.0), &turned(0.0)), 0.0);
    assert!(jump(at(0).means(), &turned(0.0)) < 1e-3);
    let (little, much) = (jump(&turned(0.0), &turned(20.0)), jump(&turned(0.0), &turned(40.0)));
    assert!(little < MAX_JUMP && MAX_JUMP < much, "{little} {much}");
    assert_eq!(jump(&[[1.0; 3]], &[[9.0; 3]]), 0.0);
    assert_eq!(jump(&[[1.0; 3]; 3], &[[9.0; 3], [1.0; 3], [-4.0; 3]]), 0.0);
}

#[test]
fn each_file_is_what_its_content_says() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder, "000.spz", &at(0));
    write_glb_to(fs::File::create(folder.path().join("001.ply")).unwrap(), &at(1)).unwrap();
    let files = TimestepFiles::open(folder.path(), ReadSettings::default()).unwrap();
    assert_eq!((files.kind(), files.num_timesteps(), files.first_frame()), ("Gaussian files", 2, Some(0)));
    assert_eq!(files.read(0..2).unwrap().means(1), at(1).means());
    assert_eq!(
        TimestepFiles::open(&folder.path().join("001.ply"), ReadSettings::default()).unwrap().kind(),
        "glTF files"
    );
    fs::write(folder.path().join("002.glb"), "nothing").unwrap();
    let (file, problem) = read(&folder).unwrap_err();
    assert_eq!((&*file, &*problem), ("002.glb", "is none of PLY, SPZ, glTF and SOG, expected one of these"));
}
