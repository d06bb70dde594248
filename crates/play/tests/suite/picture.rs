//! A viewer shows the picture that `tcgs eval` measures. Reconstruction and drawing on the GPU, within the limits of
//! every browser, are compared with the codec's sampler and the CPU's renderer.

use std::io::Write;

use crate::support::{cohorts_file, room_file, scenes, settings, wait};
use tcgs_codec::{BitMap, CompactFile, CompressSettings, DecodeLimits, SceneInfo, UpAxis, compress, encode};
use tcgs_core::{Attribute, Camera, Drawable, DynamicGaussians, Layout};
use tcgs_play::{
    BytesSource, ErrorCode, Moment, PictureRequest, Player, Reconstruction, SegmentRenderer, Viewer, start_view,
};
use tcgs_render::device::pack;
use tcgs_render::gpu::{Gpu, GpuChoice};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Bgra8Unorm;

/// The GPU that tests run on, opened as a browser does, or `None` with a message where there is none.
fn gpu() -> Option<Gpu> {
    let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
    Gpu::open_for_viewing(GpuChoice::Named(&name))
        .map_err(|error| {
            assert!(std::env::var("REQUIRE_GPU").is_err(), "a GPU is required: {error}");
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
        })
        .ok()
}

/// A timestep of a file.
fn moment(file: &[u8], timestep: usize) -> Moment {
    let mut player = Player::new(BytesSource::new(file), settings(1 << 30), timestep);
    wait(&mut player, &mut 0.0);
    player.current().unwrap()
}

fn num_timesteps(file: &[u8]) -> usize {
    moment(file, 0).segments[0].info().num_timesteps as usize
}

fn still(gpu: &Gpu, renderer: &mut SegmentRenderer, request: &PictureRequest<'_, Moment>) -> Vec<u8> {
    for _ in 0..4 {
        let still = renderer.begin_still(request).unwrap();
        gpu.wait().unwrap();
        assert!(still.is_ready());
        if let Some(pixels) = renderer.finish_still(&still).unwrap() {
            return pixels;
        }
    }
    panic!("never whole");
}

/// The picture as `tcgs render` writes it, with an alpha of 255.
fn expected(moment: &Moment, camera: &Camera, background: [f32; 3]) -> Vec<u8> {
    expected_in(moment, camera, background, [1.0; 3])
}

fn expected_in(moment: &Moment, camera: &Camera, background: [f32; 3], light: [f32; 3]) -> Vec<u8> {
    let settings = RenderSettings::default().or_background(&background);
    let drawn = Drawable::new(&moment.gaussians().lit(light)).seen_by(camera);
    let (output, _) = CpuRasterizer.forward(&drawn, camera, &settings).unwrap();
    output.image.to_rgb8().chunks_exact(3).flat_map(|pixel| [pixel[0], pixel[1], pixel[2], 255]).collect()
}

/// Share of pixels in which every channel differs by at most 2.
fn share_alike(found: &[u8], expected: &[u8]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let pixels = found.chunks_exact(4).zip(expected.chunks_exact(4));
    let alike = pixels.filter(|(a, b)| a.iter().zip(*b).all(|(a, b)| a.abs_diff(*b) <= 2)).count();
    alike as f64 / (found.len() / 4) as f64
}

/// Attributes that move together and apart, also those that training leaves alone.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let (n, t) = (700, 12);
    let room = scenes::room(n, t);
    let mut all_vary = DynamicGaussians::default();
    for timestep in 0..t {
        let mut gaussians = room.at(timestep);
        grow(gaussians.log_scales_mut(), 0.02 * timestep as f32);
        gaussians.logit_opacities_mut().iter_mut().for_each(|o| *o -= 0.1 * timestep as f32);
        all_vary.push(gaussians);
    }
    let file = |scene: &DynamicGaussians, settings: &CompressSettings| {
        encode(&compress(scene, &scenes::mixed_widths(n), None, SceneInfo::of(scene), settings).unwrap()).unwrap()
    };
    let default = CompressSettings { segment_length: Some(5), ..Default::default() };
    let paper = CompressSettings { segment_length: Some(5), ..CompressSettings::paper() };
    let mut still = scenes::room(n, 1);
    still.push(still.at(0));
    vec![
        ("default", room_file(n, t, &default)),
        ("paper", file(&scenes::room(n, t), &paper)),
        ("all attributes vary", file(&all_vary, &default)),
        ("all attributes vary, apart", file(&all_vary, &paper)),
        ("nothing moves", file(&still, &default)),
        ("a single timestep", room_file(n, 1, &default)),
    ]
}

fn grow(log_scales: &mut [[f32; 3]], by: f32) {
    log_scales.iter_mut().flatten().for_each(|x| *x += by);
}

/// A moment's visible Gaussians from the reconstruction, and from the codec and the CPU.
fn reconstructed(
    gpu: &Gpu,
    reconstruction: &mut Reconstruction,
    moment: &Moment,
    camera: &Camera,
) -> [Vec<Vec<f32>>; 2] {
    reconstruction.load(moment, camera.center()).unwrap();
    let mut encoder = gpu.encoder();
    reconstruction.record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
    gpu.submit(encoder);
    let rows = reconstruction.num_rows();
    let found: Vec<f32> = gpu.read(reconstruction.activated(), 14 * rows).unwrap();
    let drawn = Drawable::new(&moment.gaussians()).seen_by(camera);
    [by_gaussian(&found, rows), by_gaussian(&pack(&drawn), drawn.num_gaussians())]
}

/// Splits `[14 N]` values by Gaussian, and keeps those with an opacity.
fn by_gaussian(values: &[f32], n: usize) -> Vec<Vec<f32>> {
    let row = |i: usize| {
        let columns = Attribute::BASE.map(|a| {
            let (at, components) = (Layout::base().offset(a) * n, a.components());
            values[at + i * components..][..components].to_vec()
        });
        columns.concat()
    };
    (0..n).map(row).filter(|row| row[10] > 0.0).collect()
}

fn assert_alike([found, expected]: [Vec<Vec<f32>>; 2], context: &str) {
    assert_eq!(found.len(), expected.len(), "{context}");
    for (i, (a, b)) in found.iter().flatten().zip(expected.iter().flatten()).enumerate() {
        assert!((a - b).abs() <= 1e-5 * b.abs().max(0.1), "{context}: value {i} is {a}, not {b}");
    }
}

fn any_camera() -> Camera {
    Camera::look_at([0.3, -0.7, -4.0], [0.1, 0.2, 0.3], [0.0, -1.0, 0.0], 80.0, 128, 72)
}

#[test]
fn reconstruction_equals_the_codecs() {
    let Some(gpu) = gpu() else { return };
    for (name, file) in files() {
        let mut reconstruction = Reconstruction::new(&gpu).unwrap();
        let num_timesteps = num_timesteps(&file);
        // In mixed order, and from one segment to the other and back.
        for timestep in (0..num_timesteps).map(|i| i * 7 % num_timesteps) {
            let both = reconstructed(&gpu, &mut reconstruction, &moment(&file, timestep), &any_camera());
            assert_alike(both, &format!("{name}, {timestep}"));
        }
    }
}

/// Cohorts, lives, harmonics of which some move, and unknown attributes.
#[test]
fn reconstruction_equals_the_codecs_in_version_2() {
    let Some(gpu) = gpu() else { return };
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/bitstream/v2");
    let vector = |name: &str| (name.to_owned(), std::fs::read(folder.join(name).with_extension("tcgs")).unwrap());
    let mut files: Vec<_> =
        ["cohorts", "lives", "sparse", "harmonics", "shared_plan", "layers", "flip_book"].map(vector).into();
    files.extend(
        (0..4).map(|degree| (format!("room of degree {degree}"), cohorts_file(160, &Layout::with_harmonics(degree)))),
    );
    for (name, file) in files {
        let mut player = Player::new(BytesSource::new(&file[..]), settings(1 << 30), 0);
        let mut now = 0.0;
        while player.clock().is_none() {
            player.update(now).unwrap();
        }
        for timestep in 0..player.archive().unwrap().info().num_timesteps as usize {
            player.clock_mut().unwrap().seek(timestep);
            wait(&mut player, &mut now);
            // A new reconstruction, so that rows are in the order of the cohorts.
            let mut reconstruction = Reconstruction::new(&gpu).unwrap();
            let both = reconstructed(&gpu, &mut reconstruction, &player.current().unwrap(), &any_camera());
            assert_alike(both, &format!("{name}, {timestep}"));
        }
    }
}

#[test]
fn a_frame_uploads_no_gaussians() {
    let Some(gpu) = gpu() else { return };
    let file = room_file(500, 10, &CompressSettings::default());
    let now = moment(&file, 0);
    assert_eq!(now.segments[0].timesteps(), 0..10);
    let mut reconstruction = Reconstruction::new(&gpu).unwrap();
    let [before, _] = reconstructed(&gpu, &mut reconstruction, &now, &any_camera());
    let buffer = reconstruction.activated().clone();
    for timestep in [9, 3] {
        let [after, _] = reconstructed(&gpu, &mut reconstruction, &Moment { timestep, ..now.clone() }, &any_camera());
        assert_ne!(before, after);
        assert_eq!(&buffer, reconstruction.activated());
    }
}

#[test]
fn pictures_equal_the_cpu_renderers() {
    let Some(gpu) = gpu() else { return };
    let room = room_file(6000, 12, &CompressSettings { segment_length: Some(5), ..Default::default() });
    let mut files = files();
    files.push(("room", room));
    files.push(("cohorts", cohorts_file(2000, &Layout::base())));
    files.push(("harmonics", cohorts_file(2000, &Layout::with_harmonics(3))));
    files.push(("antialiased", cohorts_file(2000, &Layout::base().antialiased(true))));
    for (name, file) in &files {
        let mut renderer = SegmentRenderer::new(&gpu, FORMAT).unwrap();
        let num_timesteps = num_timesteps(file);
        let (start, _) = start_view(&moment(file, 0), &[], UpAxis::default().direction());
        // Rows of a texture are copied in multiples of 256 bytes; one size fits and the other does not.
        for (timestep, width, height) in [(0, 128, 72), (num_timesteps - 1, 101, 67), (num_timesteps / 2, 320, 180)] {
            let moment = moment(file, timestep);
            let camera = start.resized(width, height);
            let background = [0.1, 0.4, 0.25];
            let request = PictureRequest { moment: &moment, camera: &camera, background, light: [1.0; 3] };
            let found = still(&gpu, &mut renderer, &request);
            let expected = expected(&moment, &camera, background);
            let share = share_alike(&found, &expected);
            let of_background = share_alike(&vec![[26, 102, 64, 255]; width * height].concat(), &expected);
            eprintln!("{name}, timestep {timestep}, {width}x{height}: {share}; {of_background} of background");
            assert!(share >= 0.999, "{name}, timestep {timestep}, {width}x{height}: {share} of the pixels alike");
            assert!(of_background < 0.8, "there is something to see");
        }
    }
}

/// Colours are multiplied by the light; the background is not.
#[test]
fn a_picture_is_drawn_in_its_light() {
    let Some(gpu) = gpu() else { return };
    let file = room_file(6000, 12, &CompressSettings::default());
    let mut renderer = SegmentRenderer::new(&gpu, FORMAT).unwrap();
    let moment = moment(&file, 3);
    let (start, _) = start_view(&moment, &[], UpAxis::default().direction());
    let camera = start.resized(128, 72);
    let (background, light) = ([0.1, 0.4, 0.25], [0.7, 1.0, 1.2]);
    let found = still(&gpu, &mut renderer, &PictureRequest { moment: &moment, camera: &camera, background, light });
    let share = |light| share_alike(&found, &expected_in(&moment, &camera, background, light));
    assert!(share(light) >= 0.999, "{} of the pixels alike", share(light));
    assert!(share([1.0; 3]) < 0.5, "{} alike without the light", share([1.0; 3]));
}

/// Without this, the first test would prove nothing about antialiasing.
#[test]
fn antialiasing_is_seen() {
    let of = |is_antialiased: bool| {
        let moment = moment(&cohorts_file(2000, &Layout::base().antialiased(is_antialiased)), 0);
        let (start, _) = start_view(&moment, &[], UpAxis::default().direction());
        expected(&moment, &start.resized(128, 72), [0.0; 3])
    };
    assert!(share_alike(&of(true), &of(false)) < 0.9);
}

/// Removed cohorts leave nothing behind, and new ones find room, whatever the order of timesteps.
#[test]
fn cohorts_take_each_others_place() {
    let Some(gpu) = gpu() else { return };
    let file = cohorts_file(400, &Layout::with_harmonics(2));
    let mut renderer = SegmentRenderer::new(&gpu, FORMAT).unwrap();
    let (start, _) = start_view(&moment(&file, 0), &[], UpAxis::default().direction());
    let camera = start.resized(96, 54);
    for timestep in [0, 1, 2, 3, 4, 5, 8, 9, 11, 0, 6, 2, 7, 10, 3] {
        let moment = moment(&file, timestep);
        let request = PictureRequest { moment: &moment, camera: &camera, background: [0.0; 3], light: [1.0; 3] };
        let share = share_alike(&still(&gpu, &mut renderer, &request), &expected(&moment, &camera, [0.0; 3]));
        assert!(share >= 0.999, "timestep {timestep}: {share} of the pixels alike");
    }
}

#[test]
fn more_pairs_than_expected_are_drawn_again() {
    let Some(gpu) = gpu() else { return };
    // A few Gaussians that cover everything.
    let mut scene = scenes::room(300, 2);
    scene.log_scales_mut(0).fill([1.0; 3]);
    scene.logit_opacities_mut(0).fill(-3.0);
    let bits = BitMap::uniform(300, 16, 8);
    let compact = compress(&scene, &bits, None, SceneInfo::of(&scene), &CompressSettings::default());
    let file = encode(&compact.unwrap()).unwrap();
    let moment = moment(&file, 1);
    let (start, _) = start_view(&moment, &[], UpAxis::default().direction());
    let camera = start.resized(400, 300);
    let request = PictureRequest { moment: &moment, camera: &camera, background: [0.0; 3], light: [1.0; 3] };
    let mut renderer = SegmentRenderer::new(&gpu, FORMAT).unwrap();
    let texture = texture(&gpu, 400, 300);
    renderer.draw(&request, &texture).unwrap();
    gpu.wait().unwrap();
    // The count arrives a frame later; from then on the picture is right.
    renderer.draw(&request, &texture).unwrap();
    assert!(!renderer.is_whole());
    gpu.wait().unwrap();
    renderer.draw(&request, &texture).unwrap();
    assert!(renderer.is_whole());
    let found = still(&gpu, &mut SegmentRenderer::new(&gpu, FORMAT).unwrap(), &request);
    assert!(share_alike(&found, &expected(&moment, &camera, [0.0; 3])) >= 0.999);
}

fn texture(gpu: &Gpu, width: u32, height: u32) -> wgpu::TextureView {
    let texture = gpu.device().create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

#[test]
fn a_viewer_plays_pauses_and_takes_stills() {
    let Some(gpu) = gpu() else { return };
    let file = room_file(500, 12, &CompressSettings { segment_length: Some(5), ..Default::default() });
    let mut viewer: Viewer<_, SegmentRenderer> = Viewer::new((gpu.clone(), FORMAT));
    let target = texture(&gpu, 96, 64);
    assert_eq!(viewer.draw([96, 64], &target).unwrap(), None);
    assert!(!viewer.update(0.0).unwrap());
    viewer.open(Player::new(BytesSource::new(&file[..]), settings(1 << 30), 7));
    while !viewer.update(0.0).unwrap() {}
    let frame = viewer.draw([96, 64], &target).unwrap().unwrap();
    assert_eq!((frame.timestep, frame.is_playing, frame.is_buffering, frame.is_drawn), (7, false, false, true));
    viewer.clock_mut().unwrap().play();
    viewer.update(110.0).unwrap();
    let frame = viewer.draw([96, 64], &target).unwrap().unwrap();
    assert_eq!((frame.timestep, frame.is_playing), (10, true));

    viewer.controls_mut().unwrap().orbit(0.3, 0.1);
    viewer.set_background(Some([0.2, 0.3, 0.4]));
    let begun = viewer.begin_still([96, 64]).unwrap().unwrap();
    gpu.wait().unwrap();
    let pixels = viewer.finish_still(&begun).unwrap().unwrap();
    let camera = viewer.camera([96, 64]).unwrap();
    let expected = expected(&moment(&file, 10), &camera, [0.2, 0.3, 0.4]);
    assert!(share_alike(&pixels, &expected) >= 0.999);

    // Without a colour of the caller's the scene's own counts.
    let mut scene = CompactFile::decode(&file, &DecodeLimits::default()).unwrap();
    scene.cohorts[0].layout = scene.layout().with_background([51, 102, 204]);
    let colored = scene.encode(2, &[]).unwrap();
    viewer.set_background(None);
    viewer.open(Player::new(BytesSource::new(&colored[..]), settings(1 << 30), 7));
    while !viewer.update(0.0).unwrap() {}
    let begun = viewer.begin_still([96, 64]).unwrap().unwrap();
    gpu.wait().unwrap();
    let pixels = viewer.finish_still(&begun).unwrap().unwrap();
    let expected = self::expected(&moment(&file, 7), &viewer.camera([96, 64]).unwrap(), [0.2, 0.4, 0.8]);
    assert!(share_alike(&pixels, &expected) >= 0.999);

    // Another file takes its place; an invalid one leaves nothing.
    viewer.open(Player::new(BytesSource::new(&b"something else"[..]), settings(1 << 30), 0));
    assert_eq!(viewer.update(200.0).unwrap_err().code(), ErrorCode::NotTcgs);
    assert_eq!(viewer.draw([96, 64], &target).unwrap(), None);
}

#[test]
fn every_attribute_has_its_place() {
    // The reconstruction relies on these numbers of components.
    let components = Attribute::BASE.map(Attribute::components);
    assert_eq!(components, [3, 4, 3, 1, 3]);
}
