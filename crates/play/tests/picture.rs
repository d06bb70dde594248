//! What a viewer shows is what `tcgs eval` measures: reconstruction and drawing on the GPU, within the limits that every
//! browser has, against the codec's sampler and the CPU's renderer.

#![allow(clippy::unwrap_used)]

mod support;

use std::io::Write;

use support::{room_file, scenes, settings, wait};
use tcgs_codec::{BitMap, CompressSettings, Sampler, SceneInfo, Segment, UpAxis, compress, encode};
use tcgs_core::{Attribute, Camera, DynamicGaussians, activate};
use tcgs_play::{BytesSource, ErrorCode, PictureRequest, Player, Reconstruction, SegmentRenderer, Viewer, start_view};
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

/// The segment that holds a timestep.
fn segment(file: &[u8], timestep: usize) -> std::sync::Arc<Segment> {
    let mut player = Player::new(BytesSource::new(file), settings(1 << 30), timestep);
    wait(&mut player, &mut 0.0);
    player.current().unwrap().0.clone()
}

fn still(gpu: &Gpu, renderer: &mut SegmentRenderer, request: &PictureRequest<'_>) -> Vec<u8> {
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

/// As `tcgs render` writes it, with an alpha of 255.
fn expected(segment: &Segment, timestep: usize, camera: &Camera, background: [f32; 3]) -> Vec<u8> {
    let mut settings = RenderSettings::default();
    settings.background[..3].copy_from_slice(&background);
    let drawn = activate(Sampler::new(segment).at(timestep));
    let (output, _) = CpuRasterizer.forward(&drawn, camera, &settings).unwrap();
    output.image.to_rgb8().chunks_exact(3).flat_map(|pixel| [pixel[0], pixel[1], pixel[2], 255]).collect()
}

/// Share of pixels of which no channel differs by more than 2.
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

#[test]
fn reconstruction_equals_the_codecs() {
    let Some(gpu) = gpu() else { return };
    for (name, file) in files() {
        let first = segment(&file, 0);
        let n = first.num_gaussians();
        let mut reconstruction = Reconstruction::new(&gpu, &first).unwrap();
        let num_timesteps = first.info().num_timesteps as usize;
        // Not in order, and from one segment to the other and back.
        for timestep in (0..num_timesteps).map(|i| i * 7 % num_timesteps) {
            let segment = segment(&file, timestep);
            reconstruction.load(&segment).unwrap();
            reconstruction.set_timestep(timestep);
            let mut encoder = gpu.encoder();
            reconstruction.record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
            gpu.submit(encoder);
            let found: Vec<f32> = gpu.read(reconstruction.activated(), 14 * n).unwrap();
            let expected = pack(&activate(&segment.at(timestep)));
            for (i, (a, b)) in found.iter().zip(&expected).enumerate() {
                assert!((a - b).abs() <= 1e-5 * b.abs().max(0.1), "{name}, {timestep}: value {i} is {a}, not {b}");
            }
        }
    }
}

#[test]
fn a_frame_uploads_no_gaussians() {
    let Some(gpu) = gpu() else { return };
    let file = room_file(500, 10, &CompressSettings::default());
    let segment = segment(&file, 0);
    assert_eq!(segment.timesteps(), 0..10);
    let mut reconstruction = Reconstruction::new(&gpu, &segment).unwrap();
    reconstruction.load(&segment).unwrap();
    // Of this segment another one's bytes would not do: only the keypoints that lie there can give these values.
    let before: Vec<f32> = gpu.read(reconstruction.activated(), 14 * 500).unwrap();
    for timestep in [9, 3] {
        reconstruction.set_timestep(timestep);
        let mut encoder = gpu.encoder();
        reconstruction.record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
        gpu.submit(encoder);
        let now: Vec<f32> = gpu.read(reconstruction.activated(), 14 * 500).unwrap();
        assert_ne!(before, now);
    }
}

#[test]
fn pictures_equal_the_cpu_renderers() {
    let Some(gpu) = gpu() else { return };
    let room = room_file(6000, 12, &CompressSettings { segment_length: Some(5), ..Default::default() });
    let mut files = files();
    files.push(("room", room));
    for (name, file) in &files {
        let mut renderer = SegmentRenderer::new(&gpu, FORMAT, &segment(file, 0)).unwrap();
        let num_timesteps = segment(file, 0).info().num_timesteps as usize;
        let (start, _) = start_view(segment(file, 0).first().means(), UpAxis::default().direction());
        // Rows of a texture are copied in multiples of 256 bytes: sizes that are and are not.
        for (timestep, width, height) in [(0, 128, 72), (num_timesteps - 1, 101, 67), (num_timesteps / 2, 320, 180)] {
            let segment = segment(file, timestep);
            let camera = start.resized(width, height);
            let background = [0.1, 0.4, 0.25];
            let request = PictureRequest { segment: &segment, timestep, camera: &camera, background };
            let found = still(&gpu, &mut renderer, &request);
            let expected = expected(&segment, timestep, &camera, background);
            let share = share_alike(&found, &expected);
            let of_background = share_alike(&vec![[26, 102, 64, 255]; width * height].concat(), &expected);
            eprintln!("{name}, timestep {timestep}, {width}x{height}: {share}; {of_background} of background");
            assert!(share >= 0.999, "{name}, timestep {timestep}, {width}x{height}: {share} of the pixels alike");
            assert!(of_background < 0.8, "there is something to see");
        }
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
    let segment = segment(&file, 1);
    let (start, _) = start_view(segment.first().means(), UpAxis::default().direction());
    let camera = start.resized(400, 300);
    let request = PictureRequest { segment: &segment, timestep: 1, camera: &camera, background: [0.0; 3] };
    let mut renderer = SegmentRenderer::new(&gpu, FORMAT, &segment).unwrap();
    let texture = texture(&gpu, 400, 300);
    renderer.draw(&request, &texture).unwrap();
    gpu.wait().unwrap();
    // It is known a frame later, and right from then on.
    renderer.draw(&request, &texture).unwrap();
    assert!(!renderer.is_whole());
    gpu.wait().unwrap();
    renderer.draw(&request, &texture).unwrap();
    assert!(renderer.is_whole());
    let found = still(&gpu, &mut SegmentRenderer::new(&gpu, FORMAT, &segment).unwrap(), &request);
    assert!(share_alike(&found, &expected(&segment, 1, &camera, [0.0; 3])) >= 0.999);
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
    let mut viewer = Viewer::new(gpu.clone(), FORMAT);
    let target = texture(&gpu, 96, 64);
    assert_eq!(viewer.draw([96, 64], &target).unwrap(), None);
    assert!(!viewer.update(0.0).unwrap());
    viewer.open(BytesSource::new(&file[..]), settings(1 << 30), 7);
    while !viewer.update(0.0).unwrap() {}
    let frame = viewer.draw([96, 64], &target).unwrap().unwrap();
    assert_eq!((frame.timestep, frame.is_playing, frame.is_buffering, frame.is_drawn), (7, false, false, true));
    viewer.clock_mut().unwrap().play();
    viewer.update(110.0).unwrap();
    let frame = viewer.draw([96, 64], &target).unwrap().unwrap();
    assert_eq!((frame.timestep, frame.is_playing), (10, true));

    viewer.controls_mut().unwrap().orbit(0.3, 0.1);
    viewer.set_background([0.2, 0.3, 0.4]);
    let begun = viewer.begin_still([96, 64]).unwrap().unwrap();
    gpu.wait().unwrap();
    let pixels = viewer.finish_still(&begun).unwrap().unwrap();
    let camera = viewer.camera([96, 64]).unwrap();
    let expected = expected(&segment(&file, 10), 10, &camera, [0.2, 0.3, 0.4]);
    assert!(share_alike(&pixels, &expected) >= 0.999);

    // Another file takes its place; one that is none leaves nothing.
    viewer.open(BytesSource::new(&b"something else"[..]), settings(1 << 30), 0);
    assert_eq!(viewer.update(200.0).unwrap_err().code(), ErrorCode::NotTcgs);
    assert_eq!(viewer.draw([96, 64], &target).unwrap(), None);
}

#[test]
fn every_attribute_has_its_place() {
    // Reconstruction counts on it.
    let components = Attribute::BASE.map(Attribute::components);
    assert_eq!(components, [3, 4, 3, 1, 3]);
}
