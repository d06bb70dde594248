//! Time from an open file to the decoded data of any timestep, on one core: the wait after a click.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use tcgs_codec::CompressSettings;
use tcgs_play::{BytesSource, Player, PlayerSettings};

#[path = "../tests/suite/support/mod.rs"]
mod support;

/// Number of Gaussians of a demo scene, of a room with two people, and of a large scene. 150 timesteps are five
/// seconds.
const SIZES: [usize; 3] = [11_000, 60_000, 200_000];
const NUM_TIMESTEPS: usize = 150;

fn seeks(criterion: &mut Criterion) {
    // One thread, as in a browser.
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    for num_gaussians in SIZES {
        let file: std::sync::Arc<[u8]> =
            support::room_file(num_gaussians, NUM_TIMESTEPS, &CompressSettings::default()).into();
        // Opens and shows a timestep in the middle of the file.
        let open = || {
            let mut player = Player::new(BytesSource::new(file.clone()), PlayerSettings::default(), black_box(80));
            support::wait(&mut player, &mut 0.0);
            player
        };
        let mut player = open();
        let moment = player.current().expect("a moment");
        let segment = &moment.segments[0];
        assert_eq!((moment.timestep, segment.num_gaussians()), (80, num_gaussians));
        println!(
            "{num_gaussians} Gaussians, {NUM_TIMESTEPS} timesteps: {} bytes, a segment of {} timesteps holds {} bytes",
            file.len(),
            segment.timesteps().len(),
            segment.bytes()
        );
        // One segment at a time, so that every seek decodes.
        let settings = PlayerSettings { max_segment_bytes: 1, ..Default::default() };
        let mut forgetful = Player::new(BytesSource::new(file.clone()), settings, 0);
        support::wait(&mut forgetful, &mut 0.0);

        let mut group = criterion.benchmark_group(format!("{num_gaussians} Gaussians, {NUM_TIMESTEPS} timesteps"));
        group.sample_size(10);
        group.bench_function("open at a timestep", |b| b.iter(|| one_thread.install(open).segment_bytes()));
        group.bench_function("something to show of a timestep", |b| {
            b.iter(|| {
                one_thread.install(|| {
                    let mut player =
                        Player::new(BytesSource::new(file.clone()), PlayerSettings::default(), black_box(80));
                    while player.current().is_none() {
                        player.update(0.0).expect("a file");
                    }
                    player.segment_bytes()
                })
            });
        });
        // Steps through different timesteps, because a repeated timestep would already be decoded.
        let mut timestep = 0;
        group.bench_function("seek to another segment", |b| {
            b.iter(|| {
                timestep = (timestep + 60) % NUM_TIMESTEPS;
                one_thread.install(|| {
                    forgetful.clock_mut().expect("open").seek(timestep);
                    support::wait(&mut forgetful, &mut 0.0);
                });
            });
        });
        group.bench_function("seek within what is decoded", |b| {
            b.iter(|| {
                player.clock_mut().expect("open").seek(black_box(81));
                support::wait(&mut player, &mut 0.0);
            });
        });
        group.finish();
    }
}

criterion_group!(benches, seeks);
criterion_main!(benches);
