//! Time of a frame in the worker of a page with WebGL2, on one core; and the fragments that the frame draws.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use tcgs_codec::{CompressSettings, UpAxis};
use tcgs_core::{Camera, Drawable};
use tcgs_play::{Arranger, BytesSource, Moment, Player, PlayerSettings, start_view};
use tcgs_render::settings::MIN_ALPHA;
use tcgs_render::{SplatCamera, project};

#[path = "../tests/suite/support/mod.rs"]
mod support;

/// A large scene, in which all means, rotations and colours move. 30 timesteps are a second.
const NUM_GAUSSIANS: usize = 200_000;
const NUM_TIMESTEPS: usize = 30;

/// Number of pixels of all quads, without clipping: four times the product of the half axes of each.
fn fragments(moment: &Moment, order: &[u32], camera: &Camera) -> f64 {
    let drawable = Drawable::new(&moment.gaussians()).seen_by(camera);
    let view = SplatCamera::<f32>::new(camera);
    let area = |&row: &u32| {
        let row = row as usize;
        let Some(splat) = project(drawable.means[row], drawable.quats[row], drawable.scales[row], &view) else {
            return 0.0;
        };
        let [xx, xy, yy] = splat.covariance2d.map(f64::from);
        let opacity = f64::from(drawable.opacities[row]);
        8.0 * (opacity / MIN_ALPHA).ln().max(0.0) * (xx * yy - xy * xy).sqrt()
    };
    order.iter().map(area).sum()
}

fn frames(criterion: &mut Criterion) {
    // One thread, as in a worker.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let file: std::sync::Arc<[u8]> =
        support::room_file(NUM_GAUSSIANS, NUM_TIMESTEPS, &CompressSettings::default()).into();
    let mut player = Player::new(BytesSource::new(file.clone()), PlayerSettings::default(), 0);
    support::wait(&mut player, &mut 0.0);
    let first = player.current().expect("a moment");
    let (start, _) = start_view(&first, &[], UpAxis::default().direction());
    let camera = start.resized(1920, 1080);
    let mut arranger = Arranger::default();
    arranger.arrange(&first, &camera);
    println!(
        "{} of {NUM_GAUSSIANS} Gaussians are sorted; {:.1} M fragments at 1920x1080",
        arranger.order().len(),
        1e-6 * fragments(&first, arranger.order(), &camera)
    );
    assert!(arranger.order().len() > NUM_GAUSSIANS / 4);

    let mut group = criterion.benchmark_group(format!("{NUM_GAUSSIANS} Gaussians"));
    group.sample_size(20);
    // Through all segments, each of which is decoded again.
    let settings = PlayerSettings { max_segment_bytes: 1, ..Default::default() };
    let mut player = Player::new(BytesSource::new(file), settings, 0);
    support::wait(&mut player, &mut 0.0);
    let mut timestep = 0;
    group.bench_function("decode, interpolate and sort a timestep", |b| {
        b.iter(|| {
            timestep = (timestep + 1) % NUM_TIMESTEPS;
            one_thread.install(|| {
                player.clock_mut().expect("open").seek(timestep);
                support::wait(&mut player, &mut 0.0);
                arranger.arrange(&player.current().expect("a moment"), &camera);
            });
        });
    });
    let moments: Vec<Moment> =
        first.segments[0].timesteps().map(|timestep| Moment { timestep, ..first.clone() }).collect();
    let mut index = 0;
    group.bench_function("interpolate and sort a timestep", |b| {
        b.iter(|| {
            index = (index + 1) % moments.len();
            one_thread.install(|| arranger.arrange(black_box(&moments[index]), &camera))
        });
    });
    let cameras = [start.resized(1920, 1080), start.resized(1920, 1082)];
    group.bench_function("sort for another camera", |b| {
        b.iter(|| {
            index += 1;
            one_thread.install(|| arranger.arrange(&moments[0], black_box(&cameras[index % 2])))
        });
    });
    let mut copy = vec![0_u32; arranger.rows().len()];
    group.bench_function("copy of the rows", |b| b.iter(|| black_box(&mut copy).copy_from_slice(arranger.rows())));
    group.finish();
}

criterion_group!(benches, frames);
criterion_main!(benches);
