//! Checkpoints as files: old formats stay readable, damaged files are refused.

use std::fs;
use std::path::{Path, PathBuf};

use tcgs_core::{Life, Lives, PointCloud};
use tcgs_interchange::NpzReader;
use tcgs_train::{Checkpoint, GateRecord, Lifetimes, Optimizer, Parameters, Pose, Run, TrainConfig, TrainError};

/// A run in the first format of checkpoints; see its README.md.
const OLD: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../testdata/run");

fn old(timestep: usize) -> PathBuf {
    Path::new(OLD).join(format!("checkpoints/{timestep:06}.npz"))
}

fn load(path: &Path, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
    Checkpoint::load(path, first, true)
}

#[test]
fn a_run_of_the_first_version_is_read() {
    let run = Run::open(OLD.as_ref()).unwrap();
    let trained = run.trained().unwrap();
    assert_eq!((trained.scene.num_timesteps(), trained.scene.num_gaussians()), (2, 18));
    assert!(run.resume().unwrap().is_some());
    let (bit_map, _) = trained.quantization.unwrap();
    assert!(bit_map.widths.iter().all(|widths| widths.len() == 18));
    // Values as read by Python's struct module.
    let mut first = NpzReader::open(&old(0)).unwrap();
    assert_eq!(first.array_of::<f32>("means").unwrap().values[..2], [-2.673_492_7, -1.256_459_5]);
    assert_eq!(first.array_of::<u64>("steps").unwrap().shape, [6]);
}

#[test]
fn a_setting_that_is_gone_is_passed_over_where_it_was_off() {
    let folder = tempfile::tempdir().unwrap();
    let config = TrainConfig::default();
    Run::create(folder.path(), &config).unwrap();
    let file = folder.path().join("config.toml");
    let text = fs::read_to_string(&file).unwrap();
    let opened = |value: &str| {
        fs::write(&file, text.replace("[mask]\n", &format!("[mask]\nrelative = {value}\n"))).unwrap();
        Run::open(folder.path()).map(|run| run.config().clone())
    };
    assert_eq!(opened("false").unwrap(), config);
    assert!(opened("true").unwrap_err().to_string().contains("mask.relative is true, expected false"));
}

#[test]
fn a_checkpoint_of_the_first_version_is_written_anew_with_the_same_values() {
    let folder = tempfile::tempdir().unwrap();
    let first = load(&old(0), None).unwrap();
    for timestep in [0, 1] {
        let of = if timestep == 0 { None } else { Some(&first) };
        let checkpoint = load(&old(timestep), of).unwrap();
        let (path, again) = (folder.path().join("a.npz"), folder.path().join("b.npz"));
        checkpoint.save(&path, timestep == 0).unwrap();
        checkpoint.save(&again, timestep == 0).unwrap();
        assert_eq!(fs::read(&path).unwrap(), fs::read(&again).unwrap());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "something unfinished was left behind");
        assert!(load(&path, of).unwrap() == checkpoint);
        let (mut before, mut after) = (NpzReader::open(&old(timestep)).unwrap(), NpzReader::open(&path).unwrap());
        let names: Vec<String> = before.array_names().collect();
        assert!(after.array_names().eq(names.iter().cloned()), "other arrays, or in another order");
        for name in &names {
            match name.as_str() {
                "steps" => assert_eq!(before.array_of::<u64>(name).unwrap(), after.array_of::<u64>(name).unwrap()),
                "foreground" | "quantizer_groups" | "bit_widths" => {
                    assert_eq!(before.array_of::<u8>(name).unwrap(), after.array_of::<u8>(name).unwrap());
                }
                _ => {
                    let [before, after] = [&mut before, &mut after].map(|npz| npz.array_of::<f32>(name).unwrap());
                    assert_eq!(before.shape, after.shape, "{name}");
                    assert!(before.values.iter().map(|x| x.to_bits()).eq(after.values.iter().map(|x| x.to_bits())));
                }
            }
        }
    }
}

#[test]
fn damaged_checkpoints_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("000000.npz");
    let whole = fs::read(old(0)).unwrap();
    let expected = load(&old(0), None).unwrap();
    for length in (0..whole.len()).step_by(53) {
        fs::write(&path, &whole[..length]).unwrap();
        let error = load(&path, None).unwrap_err();
        assert!(matches!(error, TrainError::File { .. }), "{length} bytes: {error}");
        let error = error.to_string();
        assert!(error.contains("000000.npz: not a checkpoint") && error.lines().count() == 1, "{error}");
    }
    for at in (0..whole.len()).step_by(7) {
        let mut damaged = whole.clone();
        damaged[at] ^= 1 << (at % 8);
        fs::write(&path, &damaged).unwrap();
        match load(&path, None) {
            // A bit without effect on the arrays, such as one of a date.
            Ok(found) => assert!(found == expected, "a flip at {at} changes values unnoticed"),
            Err(error) => assert!(matches!(error, TrainError::File { .. }), "{at}: {error}"),
        }
    }
}

/// The checkpoint of a timestep at which a tenth of `N` Gaussians has moved and the rest has not.
fn sleeping(num_gaussians: usize, timestep: usize) -> Checkpoint {
    let points: Vec<[f32; 3]> = (0..num_gaussians).map(|i| [i as f32, 0.5, -1.0]).collect();
    let cloud = PointCloud { colors: points.clone(), foreground: vec![true; num_gaussians], points };
    let mut parameters = Parameters::from_cloud(&cloud, 3, 1.0);
    let moved = |i: usize| (1..=timestep).rev().find(|t| (i * 7 + t).is_multiple_of(10)).unwrap_or(0) as f32;
    for (i, mean) in parameters.gaussians.means_mut().iter_mut().enumerate() {
        mean[1] += moved(i);
    }
    for (i, color) in parameters.gaussians.colors_mut().iter_mut().enumerate() {
        color[2] -= moved(i);
    }
    let mut optimizer = Optimizer::new(&parameters, 0);
    optimizer.mask.step = timestep as u64;
    optimizer.first.colors_mut().fill([timestep as f32; 3]);
    Checkpoint {
        parameters,
        lifetimes: Lifetimes::new(num_gaussians),
        quantizers: None,
        optimizer,
        scene_radius: 2.0,
        gate: GateRecord::default(),
        unseen: Vec::new(),
        born: Pose::default(),
    }
}

/// The checkpoint of a timestep after births and deaths: of six Gaussians the third died at 1, and two were born.
fn with_lives(timestep: usize) -> Checkpoint {
    let mut checkpoint = sleeping(7, timestep);
    let mut lives: Lives = [0, 0, 0, 0, 0, 0, 1, 1].map(Life::since).into();
    lives.0[2].death = 1;
    checkpoint.lifetimes = Lifetimes { ids: vec![0, 1, 3, 4, 5, 6, 7], lives };
    checkpoint.born = Pose { means: vec![[0.0; 3]; 2], quats: vec![[0.0; 4]; 2] };
    checkpoint.gate = GateRecord { noise: vec![vec![0.1]], errors: vec![vec![0.0; 4]] };
    checkpoint.unseen = vec![1; 7];
    checkpoint
}

#[test]
fn lives_that_fit_nothing_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("000001.npz");
    let first = sleeping(6, 0);
    let read = |change: &dyn Fn(&mut Checkpoint)| {
        let mut checkpoint = with_lives(1);
        change(&mut checkpoint);
        checkpoint.save(&path, false).unwrap();
        load(&path, Some(&first)).map_err(|error| error.to_string())
    };
    assert!(read(&|_| {}).unwrap() == with_lives(1));
    let refused = |said: &str, change: &dyn Fn(&mut Checkpoint)| {
        let error = read(change).err().unwrap();
        assert!(error.contains("000001.npz: ") && error.contains(said), "{error}");
    };
    let not_left = "ids are not those that births and deaths leave";
    refused(not_left, &|c| c.lifetimes.ids[2] = 2);
    refused(not_left, &|c| c.lifetimes.ids.swap(0, 1));
    refused(not_left, &|c| c.lifetimes.ids[6] = 8);
    refused(not_left, &|c| c.lifetimes.ids.truncate(6));
    refused(not_left, &|c| c.lifetimes.lives.0[0].death = 1);
    refused("deaths do not fit births", &|c| c.lifetimes.lives.0[0].death = 0);
    refused("births are not in their order", &|c| c.lifetimes.lives.0.swap(5, 6));
    refused("births has 5 Gaussians of the first timestep, expected 6", &|c| c.lifetimes.lives.0[5].birth = 1);
    refused("gate_unseen holds 3 values, expected 7", &|c| c.unseen.truncate(3));
    refused("born_means and born_quats hold [1, 1] poses, expected 2", &|c| {
        c.born.means.truncate(1);
        c.born.quats.truncate(1);
    });
    refused("6 Gaussians live, and there are values of 7", &|c| {
        c.lifetimes.lives.0[0].death = 1;
        c.lifetimes.ids.remove(0);
    });
}

#[test]
fn a_checkpoint_of_another_run_is_named_where_a_run_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), &TrainConfig::default()).unwrap();
    let save = |timestep: usize, checkpoint: &Checkpoint| {
        checkpoint.save(&run.checkpoint_path(timestep), timestep == 0).unwrap();
    };
    save(0, &sleeping(6, 0));
    save(1, &with_lives(1));
    save(2, &with_lives(2));
    assert!(Run::open(run.folder()).unwrap().resume().unwrap().is_some());
    // No Gaussian was born there.
    save(1, &sleeping(6, 1));
    let error = Run::open(run.folder()).unwrap().resume().err().unwrap().to_string();
    assert!(error.contains("000001.npz: lacks Gaussians that live at timestep 2"), "{error}");

    // The first one must hold all Gaussians with which the run begins.
    let mut first = sleeping(6, 0);
    let mut lives = Lives::from([Life::since(0); 7]);
    lives.0[2].death = 1;
    first.lifetimes = Lifetimes { ids: vec![0, 1, 3, 4, 5, 6], lives };
    save(0, &first);
    let error = Run::open(run.folder()).unwrap().resume().err().unwrap().to_string();
    assert!(error.contains("000000.npz: has births or deaths, expected none at the first timestep"), "{error}");
    save(0, &sleeping(6, 0));

    // Mask logits of a checkpoint match the Gaussians that live.
    save(1, &with_lives(1));
    let (first, lives) = (run.checkpoint(0, None).unwrap(), run.lives(3).unwrap());
    let logits = |lives: Option<&Lives>| {
        run.mask_logits(3, &first, lives).collect::<Result<Vec<_>, _>>().map_err(|error| error.to_string())
    };
    assert_eq!(logits(lives.as_ref()).unwrap().iter().map(Vec::len).collect::<Vec<_>>(), [6, 7, 7]);
    let error = logits(None).unwrap_err();
    assert!(error.contains("000001.npz: mask_logits holds 7 values, expected 6"), "{error}");
    let number = |first: &Checkpoint| run.living(0, first, lives.as_ref()).map(|p| p.num_gaussians());
    assert_eq!(number(&first).unwrap(), 6);
    let error = number(&sleeping(7, 0)).unwrap_err().to_string();
    assert!(error.contains("000000.npz: holds 7 Gaussians, expected 6"), "{error}");
    // Only the requested timesteps count.
    assert!(run.lives(1).unwrap().is_none());
}

/// A run of `sleeping` timesteps.
fn sleeping_run(folder: &Path, num_gaussians: usize, num_timesteps: usize) -> Run {
    let run = Run::create(folder, &TrainConfig::default()).unwrap();
    (0..num_timesteps).for_each(|timestep| run.save(timestep, &sleeping(num_gaussians, timestep)).unwrap());
    run
}

fn bytes_of(folder: &Path) -> u64 {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
}

#[test]
fn what_sleeps_costs_nothing_and_every_timestep_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let (n, num_timesteps) = (2000, 100);
    sleeping_run(folder.path(), n, num_timesteps);
    let scene = |timestep: usize| {
        let whole = sleeping(n, timestep);
        let optimizer = Optimizer::new(&whole.parameters, 0);
        Checkpoint { optimizer, ..whole }
    };
    let first = Run::open(folder.path()).unwrap().checkpoint(0, None).unwrap();
    assert!(first == scene(0));
    // In order, backwards, and each from nothing.
    let orders: [Vec<usize>; 3] =
        [(1..100).collect(), (1..100).rev().collect(), vec![99, 40, 39, 41, 41, 7, 80, 79, 1]];
    for (order, timesteps) in orders.into_iter().enumerate() {
        let mut run = Run::open(folder.path()).unwrap();
        for timestep in timesteps {
            if order == 2 {
                run = Run::open(folder.path()).unwrap();
            }
            assert!(run.checkpoint(timestep, Some(&first)).unwrap() == scene(timestep), "timestep {timestep}");
        }
    }
    let run = Run::open(folder.path()).unwrap();
    let logits: Vec<Vec<f32>> = run.mask_logits(num_timesteps, &first, None).map(Result::unwrap).collect();
    assert!(logits == vec![vec![1.0; n]; num_timesteps]);

    // Each as a whole archive.
    let whole = tempfile::tempdir().unwrap();
    for timestep in 0..num_timesteps {
        sleeping(n, timestep).save(&whole.path().join(format!("{timestep:06}.npz")), timestep == 0).unwrap();
    }
    let (after, before) = (bytes_of(&folder.path().join("checkpoints")), bytes_of(whole.path()));
    assert!(after * 10 < before, "{after} bytes, whole they are {before}");
}

#[test]
fn resuming_reads_fewer_than_fifty_files() {
    let folder = tempfile::tempdir().unwrap();
    for num_timesteps in [80, 81, 82, 120] {
        let (all, few) =
            (folder.path().join(format!("all{num_timesteps}")), folder.path().join(format!("{num_timesteps}")));
        sleeping_run(&all, 50, num_timesteps);
        Run::create(&few, &TrainConfig::default()).unwrap();
        // The others exist but are damaged.
        for timestep in 0..num_timesteps {
            let name = format!("checkpoints/{timestep:06}.npz");
            let is_needed = timestep == 0 || timestep + 48 >= num_timesteps;
            if is_needed {
                fs::copy(all.join(&name), few.join(&name)).map(drop)
            } else {
                fs::write(few.join(&name), b"")
            }
            .unwrap();
        }
        for name in ["resume0.npz", "resume1.npz"] {
            fs::copy(all.join(name), few.join(name)).unwrap();
        }
        let mut resumed = Run::open(&few).unwrap().resume().unwrap().unwrap();
        assert!(resumed.checkpoint().unwrap() == sleeping(50, num_timesteps - 1), "after {num_timesteps} timesteps");
    }
}

#[test]
fn bytes_do_not_depend_on_what_was_read_before() {
    let folder = tempfile::tempdir().unwrap();
    let (one, anew) = (folder.path().join("one"), folder.path().join("anew"));
    sleeping_run(&one, 40, 45);
    sleeping_run(&anew, 40, 1);
    for timestep in 1..45 {
        Run::open(&anew).unwrap().save(timestep, &sleeping(40, timestep)).unwrap();
    }
    for timestep in 0..45 {
        let of = |run: &Path| fs::read(run.join(format!("checkpoints/{timestep:06}.npz"))).unwrap();
        assert!(of(&one) == of(&anew), "timestep {timestep}");
    }
}

#[test]
fn an_old_run_goes_on_in_the_new_form() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), Run::open(OLD.as_ref()).unwrap().config()).unwrap();
    for timestep in [0, 1] {
        fs::copy(old(timestep), run.checkpoint_path(timestep)).unwrap();
    }
    let first = run.checkpoint(0, None).unwrap();
    let last = run.resumable(1, Some(&first)).unwrap();
    assert!(last == load(&old(1), Some(&first)).unwrap(), "with the optimizer's state");
    run.save(2, &last).unwrap();
    assert!(fs::metadata(run.checkpoint_path(2)).unwrap().len() * 2 < fs::metadata(old(1)).unwrap().len());
    assert!(Run::open(folder.path()).unwrap().resumable(2, Some(&first)).unwrap() == last);
}

#[test]
fn a_broken_link_is_named() {
    let folder = tempfile::tempdir().unwrap();
    sleeping_run(folder.path(), 30, 60);
    let read = |timestep: usize| {
        let run = Run::open(folder.path()).unwrap();
        let first = run.checkpoint(0, None).unwrap();
        run.checkpoint(timestep, Some(&first))
    };
    let problem = |timestep: usize| {
        let error = read(timestep).unwrap_err().to_string();
        assert_eq!(error.lines().count(), 1, "{error}");
        error
    };
    let path = |timestep: usize| folder.path().join(format!("checkpoints/{timestep:06}.npz"));
    fs::rename(path(50), path(999)).unwrap();
    let error = problem(55);
    assert!(
        error.contains("000050.npz: not a checkpoint: ") && error.ends_with("; 000051.npz continues it"),
        "{error}"
    );
    assert!(read(49).is_ok() && read(39).is_ok());
    fs::copy(path(45), path(50)).unwrap();
    assert!(problem(55).contains("000050.npz: holds timestep 45, expected timestep 50"));
    fs::write(path(50), &fs::read(path(999)).unwrap()[..300]).unwrap();
    assert!(problem(50).contains("000050.npz: not a checkpoint: "));
    fs::rename(path(999), path(50)).unwrap();
    assert!(read(55).is_ok());
    // A state of another than the last timestep.
    fs::copy(folder.path().join("resume0.npz"), folder.path().join("resume1.npz")).unwrap();
    let error = Run::open(folder.path()).unwrap().resume().unwrap_err().to_string();
    assert!(error.contains("resume1.npz: holds timestep 58, expected timestep 59"), "{error}");
}

#[test]
fn a_flipped_bit_in_a_link_changes_no_values_unnoticed() {
    let folder = tempfile::tempdir().unwrap();
    sleeping_run(folder.path(), 30, 4);
    let run = Run::open(folder.path()).unwrap();
    let first = run.checkpoint(0, None).unwrap();
    let expected: Vec<Checkpoint> = (1..4).map(|t| run.checkpoint(t, Some(&first)).unwrap()).collect();
    let path = run.checkpoint_path(2);
    let whole = fs::read(&path).unwrap();
    let mut noticed = 0;
    for at in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[at] ^= 1 << (at % 8);
        fs::write(&path, &damaged).unwrap();
        for timestep in [2, 3] {
            match Run::open(folder.path()).unwrap().checkpoint(timestep, Some(&first)) {
                Ok(found) => assert!(found == expected[timestep - 1], "a flip at {at} changes values unnoticed"),
                Err(error) => {
                    noticed += 1;
                    assert!(error.to_string().contains("000002.npz"), "{at}: {error}");
                }
            }
        }
    }
    assert!(noticed > whole.len(), "{noticed} of {} reads", 2 * whole.len());
}
