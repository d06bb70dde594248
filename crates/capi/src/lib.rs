//! The decoder of `.tcgs` scenes for C: the functions of `include/tcgs.h`.
//!
//! What lives here: pointers, lengths and status codes, checked, around [`tcgs_codec::SceneFile`]. `examples/play.c`
//! uses all of it. No panic unwinds into the caller: a panic is a defect, and becomes [`Status::Defect`].

mod source;
mod status;

use std::ffi::{CStr, CString, c_char};
use std::io::Cursor;
use std::path::Path;

use tcgs_codec::{DecodeLimits, SceneFile, SegmentCache};
use tcgs_core::{Gaussians, SceneReader, activate, open_file};

use self::source::{Callback, Source};
pub use self::status::Status;
use self::status::{Failure, guarded};

/// An open scene.
pub struct Scene {
    file: SceneFile<Source>,
    name: CString,
}

/// The properties of a scene, as `tcgs_scene_info` returns them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneInfo {
    /// Timesteps, counted from 0.
    pub num_timesteps: u32,
    /// No timestep has more Gaussians: arrays of this length hold every timestep.
    pub max_gaussians: u32,
    /// Timesteps per second; 0 if the file does not say.
    pub frame_rate: f32,
    /// Degree of the spherical harmonics, 0 to 3. At 0 a colour is the same from every direction.
    pub sh_degree: u32,
    /// 1 if splats are antialiased, else 0. A renderer of antialiased splats compensates the opacity: 3D Gaussian
    /// splatting widens a splat by a pixel's extent, and the opacity is multiplied by sqrt(det(covariance before) /
    /// det(covariance after)).
    pub antialiased: u32,
    /// World axis that points up: 0 unknown, 1 to 6 for x, y, z, -x, -y, -z. Axes are right-handed.
    pub up: u32,
    /// Smallest coordinates of all centres at all timesteps, scene units.
    pub bounds_min: [f32; 3],
    /// Largest coordinates of all centres at all timesteps, scene units.
    pub bounds_max: [f32; 3],
    /// Colour behind all Gaussians: red, green and blue, sRGB in [0, 1]. The Gaussians are to be drawn on it.
    pub background: [f32; 3],
}

/// The caller's arrays for the Gaussians of one timestep, each of `capacity` rows. NULL for an array that is not
/// wanted.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Arrays {
    /// Number of rows that each array has room for; `max_gaussians` is enough for every timestep.
    pub capacity: usize,
    /// `[capacity, 3]` centres, scene units.
    pub means: *mut f32,
    /// `[capacity, 4]` unit rotations: w, x, y, z.
    pub quats: *mut f32,
    /// `[capacity, 3]` standard deviations along the axes, scene units.
    pub scales: *mut f32,
    /// `[capacity]` opacities, 0 to 1.
    pub opacities: *mut f32,
    /// `[capacity, 3]` colours: red, green, blue; with harmonics, the part that does not depend on the direction.
    pub colors: *mut f32,
    /// `[capacity, (sh_degree + 1)^2 - 1, 3]` coefficients of the harmonics from degree 1 on, in the order of 3D
    /// Gaussian splatting; unused where `sh_degree` is 0.
    pub harmonics: *mut f32,
}

/// Copies a part of the file into a buffer.
///
/// - `user`: as given to `tcgs_open_reader`
/// - `offset`, `length`: bytes of the file, always within its size
/// - `buffer`: room for `length` bytes
/// - returns: 0, or any other number if the bytes cannot be read; the call then fails with TCGS_STATUS_IO
pub type ReadFunction =
    Option<unsafe extern "C" fn(user: *mut std::ffi::c_void, offset: u64, buffer: *mut u8, length: usize) -> i32>;

/// Opens a scene from a file. Close it with `tcgs_close`.
///
/// - `path`: UTF-8, ends with a zero byte
/// - `scene`: receives the scene; NULL if this fails
///
/// # Safety
/// `path` points to a text that ends with a zero byte, and `scene` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_open_file(path: *const c_char, scene: *mut *mut Scene) -> Status {
    guarded(|| {
        // Safety: by contract.
        let to = unsafe { out(scene, "scene")? };
        if path.is_null() {
            return Err(Failure::argument("path", "NULL", "a text"));
        }
        // Safety: by contract.
        let path = unsafe { CStr::from_ptr(path) };
        let text = path.to_str().map_err(|_| Failure::argument("path", "bytes", "UTF-8"))?;
        let file = open_file(Path::new(text)).map_err(|error| Failure::new(Status::Io, format!("{text}: {error}")))?;
        *to = open(Source::File(file))?;
        Ok(())
    })
}

/// Opens a scene from the bytes of a file, which are copied. Close it with `tcgs_close`.
///
/// - `bytes`, `length`: the whole file
/// - `scene`: receives the scene; NULL if this fails
///
/// # Safety
/// `bytes` points to `length` bytes, and `scene` to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_open_bytes(bytes: *const u8, length: usize, scene: *mut *mut Scene) -> Status {
    guarded(|| {
        // Safety: by contract.
        let to = unsafe { out(scene, "scene")? };
        if bytes.is_null() {
            return Err(Failure::argument("bytes", "NULL", "the bytes of a file"));
        }
        // Safety: by contract.
        let bytes = unsafe { std::slice::from_raw_parts(bytes, length) };
        *to = open(Source::Bytes(Cursor::new(bytes.to_vec())))?;
        Ok(())
    })
}

/// Opens a scene whose bytes a function reads range by range, when they are needed: from an archive, or over a network.
/// Close it with `tcgs_close`.
///
/// - `read`: called by this function and by `tcgs_read`, on their thread
/// - `user`: passed to `read`
/// - `size`: length of the file, bytes
/// - `scene`: receives the scene; NULL if this fails
///
/// # Safety
/// `read` fulfils its contract, with `user`, until the scene is closed; `scene` points to a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_open_reader(
    read: ReadFunction,
    user: *mut std::ffi::c_void,
    size: u64,
    scene: *mut *mut Scene,
) -> Status {
    guarded(|| {
        // Safety: by contract.
        let to = unsafe { out(scene, "scene")? };
        let read = read.ok_or_else(|| Failure::argument("read", "NULL", "a function"))?;
        *to = open(Source::Callback(Callback::new(read, user, size)))?;
        Ok(())
    })
}

/// Closes a scene; NULL is ignored.
///
/// # Safety
/// `scene` comes from an open function, and is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_close(scene: *mut Scene) {
    if !scene.is_null() {
        // Safety: by contract.
        drop(unsafe { Box::from_raw(scene) });
    }
}

/// Returns the properties of a scene.
///
/// # Safety
/// `scene` is open, and `info` points to a `TcgsSceneInfo`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_scene_info(scene: *const Scene, info: *mut SceneInfo) -> Status {
    guarded(|| {
        // Safety: by contract.
        let scene = unsafe { scene.as_ref() }.ok_or_else(|| Failure::argument("scene", "NULL", "an open scene"))?;
        // Safety: by contract.
        let to = unsafe { info.as_mut() }.ok_or_else(|| Failure::argument("info", "NULL", "a TcgsSceneInfo"))?;
        let (of_file, [bounds_min, bounds_max]) = (scene.file.info(), scene.file.archive().bounds());
        *to = SceneInfo {
            num_timesteps: of_file.num_timesteps,
            max_gaussians: scene.file.max_gaussians() as u32,
            frame_rate: of_file.frame_rate,
            sh_degree: scene.file.layout().sh_degree() as u32,
            antialiased: u32::from(scene.file.layout().is_antialiased()),
            up: of_file.up as u32,
            bounds_min,
            bounds_max,
            background: scene.file.layout().background_color(),
        };
        Ok(())
    })
}

/// Name of the scene's capture: UTF-8 that ends with a zero byte and lives until the scene is closed. Empty if the file
/// has no name, NULL if `scene` is NULL.
///
/// # Safety
/// `scene` is open, or NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_scene_name(scene: *const Scene) -> *const c_char {
    // Safety: by contract.
    unsafe { scene.as_ref() }.map_or(std::ptr::null(), |scene| scene.name.as_ptr())
}

/// Reads the Gaussians that live at a timestep, ready to be drawn. Successive calls are fastest for successive
/// timesteps.
///
/// - `timestep`: below `num_timesteps`
/// - `arrays`: filled from their first row on; untouched if this fails
/// - `num_gaussians`: receives the number of Gaussians that live at this timestep
///
/// # Safety
/// `scene` is open; arrays that are not NULL have room for `capacity` rows; `num_gaussians` points to a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn tcgs_read(
    scene: *mut Scene,
    timestep: u32,
    arrays: *const Arrays,
    num_gaussians: *mut usize,
) -> Status {
    guarded(|| {
        // Safety: by contract.
        let scene = unsafe { scene.as_mut() }.ok_or_else(|| Failure::argument("scene", "NULL", "an open scene"))?;
        // Safety: by contract.
        let to = unsafe { arrays.as_ref() }.ok_or_else(|| Failure::argument("arrays", "NULL", "a TcgsArrays"))?;
        // Safety: by contract.
        let count = unsafe { num_gaussians.as_mut() };
        let count = count.ok_or_else(|| Failure::argument("num_gaussians", "NULL", "room for a number"))?;
        let num_timesteps = scene.file.info().num_timesteps;
        if timestep >= num_timesteps {
            return Err(Failure::argument("timestep", timestep, format!("one below {num_timesteps}")));
        }
        let gaussians = scene.file.lit(timestep as usize)?;
        let n = gaussians.num_gaussians();
        if n > to.capacity {
            return Err(Failure::argument("capacity", to.capacity, format!("{n} rows or more")));
        }
        // Safety: there are `n` rows of room, by contract.
        unsafe { fill(&gaussians, to) };
        *count = n;
        Ok(())
    })
}

/// Why the last failed call of this thread failed: one line of UTF-8 that ends with a zero byte. It lives until the
/// next call of this thread fails, and is empty if no call has failed.
#[unsafe(no_mangle)]
pub extern "C" fn tcgs_last_error() -> *const c_char {
    status::last_error()
}

/// Clears the output of an open function.
///
/// # Safety
/// `scene` is NULL or points to a pointer.
unsafe fn out<'a>(scene: *mut *mut Scene, name: &str) -> Result<&'a mut *mut Scene, Failure> {
    // Safety: by contract.
    let to = unsafe { scene.as_mut() }.ok_or_else(|| Failure::argument(name, "NULL", "room for a pointer"))?;
    *to = std::ptr::null_mut();
    Ok(to)
}

fn open(source: Source) -> Result<*mut Scene, Failure> {
    let file = SceneFile::open(source, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES)?;
    // For C a name ends at its first zero byte.
    let name: Vec<u8> = file.info().name.bytes().take_while(|&byte| byte != 0).collect();
    let name = CString::new(name).unwrap_or_default();
    Ok(Box::into_raw(Box::new(Scene { file, name })))
}

/// # Safety
/// Arrays that are not NULL have room for all the Gaussians.
unsafe fn fill(gaussians: &Gaussians, to: &Arrays) {
    let copy = |values: &[f32], to: *mut f32| {
        if !to.is_null() {
            // Safety: by contract; the caller's arrays are not ours.
            unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), to, values.len()) };
        }
    };
    let drawn = activate(gaussians);
    copy(drawn.means.as_flattened(), to.means);
    copy(drawn.quats.as_flattened(), to.quats);
    copy(drawn.scales.as_flattened(), to.scales);
    copy(&drawn.opacities, to.opacities);
    copy(&drawn.colors, to.colors);
    if !to.harmonics.is_null() {
        copy(&gaussians.harmonic_rows(), to.harmonics);
    }
}
