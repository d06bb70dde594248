//! The section `cams`: cameras to start from.

use super::section::Cursor;
use crate::error::DecodeError;
use crate::scene_camera::SceneCamera;

pub(super) fn write_cameras(cameras: &[SceneCamera]) -> Vec<u8> {
    let mut bytes = (cameras.len() as u16).to_le_bytes().to_vec();
    for camera in cameras {
        bytes.extend((camera.name.len() as u16).to_le_bytes());
        bytes.extend(camera.name.as_bytes());
        bytes.extend(camera.size.iter().flat_map(|side| side.to_le_bytes()));
        let numbers = [camera.focal, camera.principal];
        let numbers = numbers.as_flattened().iter().chain(camera.camera_from_world.as_flattened());
        bytes.extend(numbers.flat_map(|x| x.to_le_bytes()));
    }
    bytes
}

pub(super) fn read_cameras(mut cursor: Cursor<'_>) -> Result<Vec<SceneCamera>, DecodeError> {
    let mut cameras = Vec::new();
    for _ in 0..cursor.u16("number of cameras")? {
        let mut camera = SceneCamera { name: cursor.text("name")?, ..SceneCamera::default() };
        for side in &mut camera.size {
            *side = cursor.u32("size")?;
        }
        for pair in [&mut camera.focal, &mut camera.principal] {
            for x in pair {
                *x = cursor.f32("intrinsics")?;
            }
        }
        for x in camera.camera_from_world.as_flattened_mut() {
            *x = cursor.f32("camera_from_world")?;
        }
        camera.camera().map_err(|_| cursor.invalid("cameras", "numbers that are no camera"))?;
        cameras.push(camera);
    }
    cursor.finish()?;
    Ok(cameras)
}
