//! Timesteps that a worker arranges for WebGL2 are drawn here as the shaders draw them, and compared with the CPU's
//! renderer. A player whose scene is in a worker shows the same as any player.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;

use crate::support::{cohorts_file, room_file, settings, wait};
use tcgs_codec::{CompressSettings, UpAxis};
use tcgs_core::{Camera, Drawable, Image, Layout};
use tcgs_play::{
    Arranger, BytesSource, Changes, ErrorCode, Feed, Link, Moment, Player, ROW_WORDS, RemotePlayer, Reply, Request,
    SceneWorker, start_view,
};
use tcgs_render::settings::{MAX_ALPHA, MIN_ALPHA};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings, SplatCamera, TileMask, gaussians_reaching, project};

const BACKGROUND: [f32; 3] = [0.1, 0.4, 0.25];

fn moment(file: &[u8], timestep: usize) -> Moment {
    let mut player = Player::new(BytesSource::new(file), settings(1 << 30), timestep);
    wait(&mut player, &mut 0.0);
    player.current().unwrap()
}

fn files() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("room", room_file(6000, 12, &CompressSettings { segment_length: Some(5), ..Default::default() })),
        ("tracks apart", room_file(6000, 12, &CompressSettings::paper())),
        ("cohorts", cohorts_file(2000, &Layout::base())),
        ("harmonics", cohorts_file(2000, &Layout::with_harmonics(3))),
        ("antialiased", cohorts_file(2000, &Layout::base().antialiased(true))),
    ]
}

fn value_of_half(half: u32) -> f32 {
    let (exponent, mantissa) = ((half >> 10 & 31) as i32, (half & 1023) as f32);
    let magnitude = if exponent == 0 {
        mantissa * 2.0_f32.powi(-24)
    } else {
        (1.0 + mantissa / 1024.0) * 2.0_f32.powi(exponent - 15)
    };
    if half & 0x8000 != 0 { -magnitude } else { magnitude }
}

/// The shaders of `web/webgl2.rs` in slow words: each splat at every pixel, from back to front.
fn drawn(rows: &[u32], order: &[u32], is_antialiased: bool, camera: &Camera) -> Image {
    let (width, height) = (camera.width, camera.height);
    let mut image = Image::filled(width, height, 3, 0.0);
    for (channel, value) in BACKGROUND.into_iter().enumerate() {
        image.data[channel * width * height..][..width * height].fill(value);
    }
    let view = SplatCamera::<f32>::new(camera);
    for &row in order {
        let words = &rows[ROW_WORDS * row as usize..][..ROW_WORDS];
        let float = |i: usize| f32::from_bits(words[i]);
        let quat = [float(4), float(5), float(6), float(7)];
        let scale = [float(8), float(9), float(10)];
        let halves = [words[3] & 0xffff, words[3] >> 16, words[11] & 0xffff, words[11] >> 16].map(value_of_half);
        let Some(splat) = project([float(0), float(1), float(2)], quat, scale, &view) else { continue };
        let opacity = halves[3] * if is_antialiased { splat.kept_opacity() } else { 1.0 };
        for y in 0..height {
            for x in 0..width {
                let d = [x as f32 + 0.5 - splat.mean2d[0], y as f32 + 0.5 - splat.mean2d[1]];
                let [xx, xy, yy] = splat.conic;
                let exponent = 0.5 * (xx * d[0] * d[0] + yy * d[1] * d[1]) + xy * d[0] * d[1];
                let alpha = (opacity * (-exponent).exp()).min(MAX_ALPHA as f32);
                if alpha >= MIN_ALPHA as f32 {
                    for channel in 0..3 {
                        let value = &mut image.data[(channel * height + y) * width + x];
                        *value += alpha * (halves[channel] - *value);
                    }
                }
            }
        }
    }
    image
}

fn expected(moment: &Moment, camera: &Camera) -> Image {
    let settings = RenderSettings::default().or_background(&BACKGROUND);
    let drawable = Drawable::new(&moment.gaussians()).seen_by(camera);
    CpuRasterizer.forward(&drawable, camera, &settings).unwrap().0.image
}

/// Mean difference of all values, and the share of those that differ by more than 8 steps of 8 bits; in steps.
fn difference(a: &Image, b: &Image) -> (f64, f64) {
    let (a, b) = (a.to_rgb8(), b.to_rgb8());
    let sum: u64 = a.iter().zip(&b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    let far = a.iter().zip(&b).filter(|(a, b)| a.abs_diff(**b) > 8).count();
    (sum as f64 / a.len() as f64, far as f64 / a.len() as f64)
}

#[test]
fn arranged_timesteps_give_the_cpu_renderers_pictures() {
    for (name, file) in files() {
        let (start, _) = start_view(&moment(&file, 0), &[], UpAxis::default().direction());
        let mut player = Player::new(BytesSource::new(&file[..]), settings(1 << 30), 0);
        let (mut arranger, mut now) = (Arranger::default(), 0.0);
        let camera = start.resized(96, 54);
        // Back and forth, within segments and across them.
        for timestep in [0, 1, 4, 3, 11, 5, 6, 0] {
            wait(&mut player, &mut now);
            player.clock_mut().unwrap().seek(timestep);
            wait(&mut player, &mut now);
            let moment = player.current().unwrap();
            arranger.arrange(&moment, &camera);
            let found = drawn(arranger.rows(), arranger.order(), moment.is_antialiased(), &camera);
            let (mean, far) = difference(&found, &expected(&moment, &camera));
            eprintln!("{name}, timestep {timestep}: {mean:.4} steps, {:.4} % far", 100.0 * far);
            assert!(mean < 0.05 && far == 0.0, "{name}, timestep {timestep}: {mean} {far}");
        }
    }
}

/// The order holds all Gaussians that the CPU's renderer draws, from any place.
#[test]
fn nothing_visible_is_left_out() {
    for (name, file) in files() {
        let moment = moment(&file, 7);
        let (start, pivot) = start_view(&moment, &[], UpAxis::default().direction());
        let mut controls = tcgs_play::Controls::new(&start, UpAxis::default().direction(), pivot);
        let mut arranger = Arranger::default();
        for _ in 0..12 {
            controls.orbit(0.7, 0.2);
            controls.zoom(1.4);
            let camera = controls.camera([120, 80]);
            arranger.arrange(&moment, &camera);
            // Rows hold all Gaussians, and the others only those that live.
            let mut alive = Vec::new();
            let mut first = 0;
            for segment in &moment.segments {
                let all = segment.alive(7).unwrap_or_else(|| (0..segment.num_gaussians()).collect());
                alive.extend(all.into_iter().map(|g| (first + g) as u32));
                first += segment.num_gaussians();
            }
            let drawable = Drawable::new(&moment.gaussians()).seen_by(&camera);
            let order: std::collections::BTreeSet<u32> = arranger.order().iter().copied().collect();
            assert_eq!(order.len(), arranger.order().len());
            for gaussian in reached(&drawable, &camera) {
                assert!(order.contains(&alive[gaussian]), "{name}: Gaussian {gaussian}");
            }
            assert!(order.iter().all(|row| alive.contains(row)), "{name}: only what lives");
        }
    }
}

fn reached(drawable: &tcgs_core::Activated, camera: &Camera) -> Vec<usize> {
    let all = TileMask::all(camera.width, camera.height);
    let reaching = gaussians_reaching(drawable, camera, &all);
    reaching.into_iter().map(|gaussian| gaussian as usize).collect()
}

#[test]
fn only_what_changes_is_arranged_again() {
    let file = room_file(500, 10, &CompressSettings::default());
    let first = moment(&file, 0);
    let camera = Camera::look_at([0.3, -0.7, -4.0], [0.1, 0.2, 0.3], [0.0, -1.0, 0.0], 80.0, 128, 72);
    let mut arranger = Arranger::default();
    let mut arrange = |moment: &Moment, camera: &Camera| {
        let Changes { has_new_rows, has_new_order } = arranger.arrange(moment, camera);
        (has_new_rows, has_new_order)
    };
    assert_eq!(arrange(&first, &camera), (true, true));
    assert_eq!(arrange(&first, &camera), (false, false));
    assert_eq!(arrange(&first, &camera.resized(64, 36)), (false, true));
    assert_eq!(arrange(&Moment { timestep: 4, ..first }, &camera), (true, true));
}

/// Both ends of a link in one thread: what is posted waits until [`Ends::work`].
#[derive(Clone, Default)]
struct Ends {
    requests: Rc<RefCell<VecDeque<Request>>>,
    replies: Rc<RefCell<VecDeque<Reply<Vec<u32>>>>>,
}

impl Link for Ends {
    type Words = Vec<u32>;

    fn post(&mut self, request: &Request) {
        self.requests.borrow_mut().push_back(request.clone());
    }

    fn take(&mut self) -> Option<Reply<Vec<u32>>> {
        self.replies.borrow_mut().pop_front()
    }
}

impl Ends {
    fn work(&self, worker: &mut SceneWorker<BytesSource>) {
        if let Some(request) = self.requests.borrow_mut().pop_front() {
            worker.ask(request);
        }
        let reply = worker.work(0.0);
        let owned = |words: Option<&[u32]>| words.map(<[u32]>::to_vec);
        let Reply { id, bytes_loaded, failure, tables, start, timestep, is_whole, is_antialiased, rows, order } = reply;
        let (rows, order) = (owned(rows), owned(order));
        let reply = Reply { id, bytes_loaded, failure, tables, start, timestep, is_whole, is_antialiased, rows, order };
        self.replies.borrow_mut().push_back(reply);
    }
}

#[test]
fn a_player_in_a_worker_shows_what_any_player_shows() {
    for (name, file) in files() {
        let ends = Ends::default();
        let mut worker = SceneWorker::new(BytesSource::new(&file[..]), settings(1 << 30), 3);
        let mut player = RemotePlayer::new(ends.clone(), 3);
        assert!(player.is_buffering());
        while player.current().is_none() {
            player.update(0.0).unwrap();
            ends.work(&mut worker);
        }
        let start = player.start_view(&player.current().unwrap());
        let mut alone = Player::new(BytesSource::new(&file[..]), settings(1 << 30), 3);
        wait(&mut alone, &mut 0.0);
        assert_eq!(start, Feed::start_view(&alone, &alone.current().unwrap()), "{name}");
        assert_eq!(player.archive().unwrap().info(), alone.archive().unwrap().info());
        assert_eq!(player.clock().unwrap().timestep(), 3);

        // The order for the camera of the start is there before the page asks for it.
        let resized = |timestep: usize| (timestep, start.camera.resized(64 + timestep, 36));
        for (timestep, camera) in [(3, start.camera.clone()), resized(3), resized(9), resized(4)] {
            player.clock_mut().unwrap().seek(timestep);
            let mut count = 0;
            loop {
                player.update(0.0).unwrap();
                player.look(&camera);
                let shown = player.current().unwrap();
                if player.is_due(&shown, &camera) {
                    let moment = moment(&file, timestep);
                    let mut arranger = Arranger::default();
                    arranger.arrange(&moment, &camera);
                    assert_eq!((&shown.rows[..], &shown.order[..]), (arranger.rows(), arranger.order()), "{name}");
                    assert_eq!(shown.is_antialiased, moment.is_antialiased());
                    assert!(!player.is_buffering());
                    break;
                }
                assert!(ends.requests.borrow().len() <= 1, "one request at a time");
                ends.work(&mut worker);
                count += 1;
                assert!(count < 20, "{name}, timestep {timestep}");
            }
        }
    }
}

#[test]
fn time_passes_while_a_worker_is_busy_and_stands_while_something_is_missing() {
    let file = room_file(500, 12, &CompressSettings { segment_length: Some(5), ..Default::default() });
    let ends = Ends::default();
    let mut worker = SceneWorker::new(BytesSource::new(&file[..]), settings(1 << 30), 0);
    let mut player = RemotePlayer::new(ends.clone(), 0);
    for _ in 0..20 {
        player.update(0.0).unwrap();
        ends.work(&mut worker);
    }
    player.update(0.0).unwrap();
    assert!(!player.is_buffering());
    player.clock_mut().unwrap().play();
    player.update(0.0).unwrap();
    player.update(110.0).unwrap();
    assert_eq!(player.clock().unwrap().timestep(), 3, "the worker has not answered yet");
    assert_eq!(player.current().unwrap().timestep, 0);
    player.update(210.0).unwrap();
    assert_eq!(ends.requests.borrow().len(), 1);
    ends.work(&mut worker);
    player.update(210.0).unwrap();
    assert_eq!(player.current().unwrap().timestep, 3, "that was asked for first");
    // An answer that something is missing stops the clock.
    let missing = Reply { id: ends.requests.borrow()[0].id, ..Reply::default() };
    ends.replies.borrow_mut().push_back(missing);
    let before = player.clock().unwrap().position();
    player.update(250.0).unwrap();
    player.update(400.0).unwrap();
    assert_eq!(player.clock().unwrap().position(), before);
    assert!(player.is_buffering());
}

#[test]
fn an_order_that_does_not_change_is_that_of_the_last_request() {
    let file = room_file(500, 12, &CompressSettings::default());
    let ends = Ends::default();
    let mut worker = SceneWorker::new(BytesSource::new(&file[..]), settings(1 << 30), 3);
    let mut player = RemotePlayer::new(ends.clone(), 3);
    while player.current().is_none() {
        player.update(0.0).unwrap();
        ends.work(&mut worker);
    }
    let camera = player.start_view(&player.current().unwrap()).camera.resized(64, 36);
    player.look(&camera);
    ends.work(&mut worker);
    // The order comes after the next request, which changes neither timestep nor camera.
    let ordered = ends.replies.borrow_mut().pop_back().unwrap();
    assert!(ordered.order.is_some());
    ends.replies.borrow_mut().push_back(Reply { id: ordered.id, ..Reply::default() });
    player.update(0.0).unwrap();
    assert_eq!(player.current().unwrap().timestep, 3, "nothing has come for the request");
    player.clock_mut().unwrap().set_looping(false);
    player.update(0.0).unwrap();
    ends.replies.borrow_mut().push_back(ordered);
    player.update(0.0).unwrap();
    assert!(!player.is_due(&player.current().unwrap(), &camera), "it may be the order for another camera");
    ends.work(&mut worker);
    assert!(ends.replies.borrow()[0].order.is_none(), "it has not changed");
    player.update(0.0).unwrap();
    assert!(player.is_due(&player.current().unwrap(), &camera));
}

#[test]
fn errors_of_a_worker_arrive() {
    let ends = Ends::default();
    let mut worker = SceneWorker::new(BytesSource::new(&b"something else"[..]), settings(1 << 30), 0);
    let mut player = RemotePlayer::new(ends.clone(), 0);
    player.update(0.0).unwrap();
    ends.work(&mut worker);
    for _ in 0..2 {
        assert_eq!(player.update(0.0).unwrap_err().code(), ErrorCode::NotTcgs);
    }
    assert!(player.current().is_none());
    assert!(
        ErrorCode::ALL
            .iter()
            .enumerate()
            .all(|(i, code)| ErrorCode::ALL[..i].iter().all(|c| c.as_str() != code.as_str()))
    );
}
