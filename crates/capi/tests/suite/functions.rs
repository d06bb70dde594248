//! Calls the functions as a program in C does.

use std::ffi::{CStr, CString, c_void};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::ptr::{null, null_mut};

use tcgs_c::{Arrays, Scene, SceneInfo, Status};
use tcgs_c::{
    tcgs_close, tcgs_last_error, tcgs_open_bytes, tcgs_open_file, tcgs_open_reader, tcgs_read, tcgs_scene_info,
    tcgs_scene_name,
};
use tcgs_codec::{DecodeLimits, SceneFile, SegmentCache};
use tcgs_core::activate;

fn vectors(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream").join(folder);
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|ending| ending == "tcgs")).collect()
}

fn open_bytes(bytes: &[u8]) -> Result<*mut Scene, (Status, String)> {
    let mut scene = null_mut();
    // Safety: a slice, and room for a pointer.
    match unsafe { tcgs_open_bytes(bytes.as_ptr(), bytes.len(), &raw mut scene) } {
        Status::Ok => Ok(scene),
        status => {
            assert!(scene.is_null());
            Err((status, last_error()))
        }
    }
}

fn last_error() -> String {
    // Safety: it ends with a zero byte.
    unsafe { CStr::from_ptr(tcgs_last_error()) }.to_str().unwrap().into()
}

fn info(scene: *const Scene) -> SceneInfo {
    let mut info = SceneInfo::default();
    // Safety: an open scene.
    assert_eq!(unsafe { tcgs_scene_info(scene, &raw mut info) }, Status::Ok);
    info
}

/// Arrays with room for some rows, and a mark behind each.
struct Room {
    values: [Vec<f32>; 6],
    capacity: usize,
}

const MARK: f32 = -12345.0;

impl Room {
    fn new(capacity: usize, sh_degree: u32) -> Self {
        let harmonics = 3 * ((sh_degree as usize + 1).pow(2) - 1);
        Self { values: [3, 4, 3, 1, 3, harmonics].map(|width| vec![MARK; width * capacity + 1]), capacity }
    }

    fn arrays(&mut self) -> Arrays {
        let [means, quats, scales, opacities, colors, harmonics] = self.values.each_mut().map(Vec::as_mut_ptr);
        Arrays { capacity: self.capacity, means, quats, scales, opacities, colors, harmonics }
    }
}

#[test]
fn timesteps_are_those_that_the_decoder_gives() {
    let files = [vectors("v1"), vectors("v2")].concat();
    assert!(files.len() > 20);
    for path in files {
        let bytes = std::fs::read(&path).unwrap();
        let mut file =
            SceneFile::open(Cursor::new(&bytes), &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).unwrap();
        let scene = open_bytes(&bytes).unwrap();
        let info = info(scene);
        assert_eq!(info.num_timesteps, file.info().num_timesteps);
        assert_eq!(info.background, file.layout().background_color());
        // The last timestep first, so that the order does not matter.
        for timestep in (0..info.num_timesteps).rev() {
            let expected = file.at(timestep as usize).unwrap();
            let n = expected.num_gaussians();
            let mut room = Room::new(info.max_gaussians as usize, info.sh_degree);
            let mut count = usize::MAX;
            // Safety: room for the most Gaussians.
            let status = unsafe { tcgs_read(scene, timestep, &room.arrays(), &raw mut count) };
            assert_eq!((status, count), (Status::Ok, n), "{}", path.display());
            let drawn = activate(&expected);
            let [means, quats, scales, opacities, colors, harmonics] = &room.values;
            let pairs: [(&[f32], &[f32]); 5] = [
                (means, drawn.means.as_flattened()),
                (quats, drawn.quats.as_flattened()),
                (scales, drawn.scales.as_flattened()),
                (opacities, &drawn.opacities),
                (colors, &drawn.colors),
            ];
            for (found, expected) in pairs {
                let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
                assert_eq!(bits(&found[..expected.len()]), bits(expected), "{}", path.display());
                assert_eq!(found.last(), Some(&MARK));
            }
            let bands = expected.layout().harmonics();
            let mut place = 0;
            for i in 0..n {
                for &band in &bands {
                    let row = &expected.values(band)[i * band.components()..][..band.components()];
                    assert_eq!(&harmonics[place..place + row.len()], row);
                    place += row.len();
                }
            }
            assert_eq!(harmonics.last(), Some(&MARK));
        }
        // Safety: not used again.
        unsafe { tcgs_close(scene) };
    }
}

/// The file behind a caller's read function, and the number of reads.
struct Remote {
    bytes: Vec<u8>,
    reads: usize,
    fails: bool,
}

unsafe extern "C" fn read(user: *mut c_void, offset: u64, buffer: *mut u8, length: usize) -> i32 {
    // Safety: the test gives a `Remote`.
    let remote = unsafe { &mut *user.cast::<Remote>() };
    remote.reads += 1;
    if remote.fails {
        return 7;
    }
    let range = &remote.bytes[offset as usize..][..length];
    // Safety: room for `length` bytes.
    unsafe { std::ptr::copy_nonoverlapping(range.as_ptr(), buffer, length) };
    0
}

#[test]
fn a_function_reads_ranges_when_they_are_needed() {
    let path = vectors("v2").into_iter().find(|path| path.ends_with("cohorts.tcgs")).unwrap();
    let mut remote = Remote { bytes: std::fs::read(&path).unwrap(), reads: 0, fails: false };
    let (size, user) = (remote.bytes.len() as u64, (&raw mut remote).cast());
    let mut scene = null_mut();
    // Safety: `remote` lives longer than the scene.
    assert_eq!(unsafe { tcgs_open_reader(Some(read), user, size, &raw mut scene) }, Status::Ok);
    let mut room = Room::new(info(scene).max_gaussians as usize, 0);
    let (mut count, before) = (0, remote.reads);
    // Safety: room for the most Gaussians.
    let mut at = |timestep| unsafe { tcgs_read(scene, timestep, &room.arrays(), &raw mut count) };
    remote.fails = true;
    assert_eq!(at(1), Status::Io);
    assert!(last_error().contains("the caller's function gave 7 for bytes"), "{}", last_error());
    remote.fails = false;
    assert_eq!(at(1), Status::Ok);
    assert!(remote.reads > before + 1);
    // Safety: not used again.
    unsafe { tcgs_close(scene) };

    let whole = CString::new(path.to_str().unwrap()).unwrap();
    // Safety: a text, and room for a pointer.
    assert_eq!(unsafe { tcgs_open_file(whole.as_ptr(), &raw mut scene) }, Status::Ok);
    // Safety: an open scene, and a text that ends with a zero byte.
    let name = unsafe { CStr::from_ptr(tcgs_scene_name(scene)) };
    assert!(name.to_str().is_ok());
    // Safety: not used again.
    unsafe { tcgs_close(scene) };
}

#[test]
fn what_is_wrong_is_said_in_one_line() {
    for path in [vectors("refused"), vectors("refused_v2")].concat() {
        let Err((status, line)) = open_bytes(&std::fs::read(&path).unwrap()) else { continue };
        assert!([Status::Format, Status::Version, Status::Limit].contains(&status), "{}", path.display());
        assert!(line.contains("expected") || line.contains("invalid") || line.contains("needs"), "{line}");
        assert!(!line.contains('\n') && !line.is_empty());
    }
    assert!(matches!(open_bytes(b"no scene"), Err((Status::Format, _))));

    let scene = open_bytes(&std::fs::read(&vectors("v2")[0]).unwrap()).unwrap();
    let n = info(scene).num_timesteps;
    let (mut count, mut room) = (0, Room::new(0, 0));
    // Safety: NULL and no room at all are refused.
    unsafe {
        assert_eq!(tcgs_read(scene, n, &room.arrays(), &raw mut count), Status::Argument);
        assert_eq!(last_error(), format!("timestep: found {n}, expected one below {n}"));
        assert_eq!(tcgs_read(scene, 0, null(), &raw mut count), Status::Argument);
        assert_eq!(tcgs_read(null_mut(), 0, &room.arrays(), &raw mut count), Status::Argument);
        assert_eq!(tcgs_read(scene, 0, &room.arrays(), null_mut()), Status::Argument);
        assert_eq!(tcgs_scene_info(null(), null_mut()), Status::Argument);
        assert_eq!(tcgs_open_bytes(null(), 0, null_mut()), Status::Argument);
        assert_eq!(tcgs_open_reader(None, null_mut(), 0, &mut null_mut::<Scene>()), Status::Argument);
        assert!(tcgs_scene_name(null()).is_null());
        let missing = c"/no/such/scene.tcgs";
        assert_eq!(tcgs_open_file(missing.as_ptr(), &mut null_mut::<Scene>()), Status::Io);
        assert!(last_error().starts_with("/no/such/scene.tcgs: "));
        tcgs_close(null_mut());
        tcgs_close(scene);
    }
}
