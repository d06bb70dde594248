//! Videos that the program `ffmpeg` decodes, frame by frame through a pipe. Nothing is extracted to the disk.
//!
//! `ffprobe` lists the presentation times; `ffmpeg` then writes frames in that order. In sequential order each frame is
//! decoded once. For a frame before the last one, or far ahead of it, `ffmpeg` is started again at that moment.

use std::collections::VecDeque;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{ChildStdout, Command, Stdio};
use std::sync::{Mutex, OnceLock, PoisonError};

use image::RgbImage;
use serde::Deserialize;

use super::Times;
use super::child::Program;
use crate::CaptureError;

/// Bytes of decoded frames that a video keeps; the last frame is always kept.
const KEPT_BYTES: usize = 16 << 20;
/// Most bytes of a description at a hundred bytes a frame: as many frames as the built-in decoder takes.
const MAX_PROBE_BYTES: u64 = 1 << 28;
/// Largest width and height of a video, pixels.
const MAX_SIDE: usize = 1 << 14;
/// Number of frames that are decoded and dropped rather than starting `ffmpeg` again.
const MAX_SKIPPED: usize = 250;

/// A video that `ffmpeg` decodes.
#[derive(Debug)]
pub(super) struct ProgramVideo {
    path: PathBuf,
    /// As stored, pixels.
    pub size: (usize, usize),
    /// Name of the codec, such as `vp9`.
    pub codec: String,
    /// Clockwise quarter turns for players, as the file says.
    pub quarter_turns: u8,
    /// Start of the file's clock; `ffmpeg` counts from it when it seeks.
    begin_secs: f64,
    /// Whether `ffmpeg` can seek to a frame: the file has presentation times.
    can_seek: bool,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    running: Option<Running>,
    /// Latest last.
    kept: VecDeque<(usize, RgbImage)>,
}

/// A running `ffmpeg`; dropping it ends the process.
#[derive(Debug)]
struct Running {
    /// Held until it is dropped.
    _program: Program,
    frames: BufReader<ChildStdout>,
    /// The next frame from the pipe.
    next_frame: usize,
}

#[derive(Deserialize)]
struct Probe {
    #[serde(default)]
    packets: Vec<Packet>,
    #[serde(default)]
    streams: Vec<Stream>,
    format: Option<Format>,
}

#[derive(Deserialize)]
struct Packet {
    pts_time: Option<String>,
    dts_time: Option<String>,
    #[serde(default)]
    flags: String,
}

#[derive(Deserialize)]
struct Stream {
    codec_name: Option<String>,
    width: Option<usize>,
    height: Option<usize>,
    #[serde(default)]
    tags: Tags,
    #[serde(default)]
    side_data_list: Vec<SideData>,
}

#[derive(Default, Deserialize)]
struct Tags {
    rotate: Option<String>,
}

#[derive(Deserialize)]
struct SideData {
    rotation: Option<f64>,
}

#[derive(Deserialize)]
struct Format {
    start_time: Option<String>,
}

impl ProgramVideo {
    /// Reads everything but the frames.
    ///
    /// - `problem`: why the built-in decoder does not read the video
    pub fn open(path: &Path, problem: &str) -> Result<(Self, Times), CaptureError> {
        let invalid = |problem: String| CaptureError::invalid(path, problem);
        let entries = "stream=codec_name,width,height:stream_tags=rotate:stream_side_data=rotation:\
                       packet=pts_time,dts_time,flags:format=start_time";
        let mut probe = Command::new("ffprobe");
        probe.args(["-v", "error", "-select_streams", "V:0", "-show_entries", entries, "-of", "json"]);
        let output = Program::output(probe.arg(in_place(path)), MAX_PROBE_BYTES);
        let (is_video, described, complaints) = output.map_err(|error| {
            invalid(format!("{problem}; other videos are read by the programs ffmpeg and ffprobe: {error}"))
        })?;
        if !is_video {
            return Err(invalid(format!("is no video: ffprobe said: {}", last_line(&complaints))));
        }
        let probe: Probe = serde_json::from_slice(&described)
            .map_err(|error| invalid(format!("ffprobe described it in an unknown way: {error}")))?;
        let stream = probe.streams.into_iter().next();
        let stream = stream.ok_or_else(|| invalid("has no video, expected a file with one".into()))?;
        let (Some(width), Some(height)) = (stream.width, stream.height) else {
            return Err(invalid("has a video of no size, expected one of at least 1x1 pixels".into()));
        };
        if [width, height].iter().any(|side| !(1..=MAX_SIDE).contains(side)) {
            return Err(invalid(format!("is {width}x{height} pixels, expected 1 to {MAX_SIDE} a side")));
        }
        let number = |text: &String| text.parse::<f64>().ok().filter(|secs| secs.is_finite());
        // Packets that are decoded only for other frames are not shown.
        let shown: Vec<&Packet> = probe.packets.iter().filter(|packet| !packet.flags.contains('D')).collect();
        let times = |of: fn(&Packet) -> &Option<String>| -> Option<Vec<f64>> {
            shown.iter().map(|packet| of(packet).as_ref().and_then(number)).collect()
        };
        // AVI has decoding times only. In order these equal the presentation times up to a delay.
        let shown_at = times(|packet| &packet.pts_time);
        let can_seek = shown_at.is_some();
        let mut times = shown_at.or_else(|| times(|packet| &packet.dts_time)).unwrap_or_default();
        times.sort_by(f64::total_cmp);
        if times.is_empty() {
            return Err(invalid("has no frames with a time, expected some".into()));
        }
        // A display matrix turns anticlockwise, the older tag clockwise.
        let matrix = stream.side_data_list.iter().find_map(|data| data.rotation).map(|degrees| -degrees);
        let degrees = matrix.or(stream.tags.rotate.as_ref().and_then(number)).unwrap_or(0.0);
        let video = Self {
            path: path.into(),
            size: (width, height),
            codec: stream.codec_name.unwrap_or_else(|| "unknown".into()),
            quarter_turns: (degrees / 90.0).round().rem_euclid(4.0) as u8,
            begin_secs: probe.format.and_then(|format| format.start_time.as_ref().and_then(number)).unwrap_or(0.0),
            can_seek,
            state: Mutex::default(),
        };
        Ok((video, Times::listed(times)))
    }

    /// Decodes a frame.
    ///
    /// - `times`: as [`Self::open`] returned them
    pub fn frame(&self, frame: usize, times: &Times) -> Result<RgbImage, CaptureError> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, image)) = state.kept.iter().find(|(kept, _)| *kept == frame) {
            return Ok(image.clone());
        }
        let goes_on = |r: &Running| (r.next_frame..=r.next_frame + MAX_SKIPPED).contains(&frame);
        let mut running = match state.running.take().filter(goes_on) {
            Some(running) => running,
            None => self.start(frame, times)?,
        };
        let (width, height) = self.size;
        let mut pixels = vec![0; 3 * width * height];
        while running.next_frame <= frame {
            if let Err(error) = running.frames.read_exact(&mut pixels) {
                let (found, expected) = (running.next_frame, times.num_frames());
                let problem = format!("ends early: {found} of {expected} frames could be decoded ({error})");
                return Err(CaptureError::invalid(&self.path, problem));
            }
            running.next_frame += 1;
        }
        state.running = Some(running);
        let image = RgbImage::from_raw(width as u32, height as u32, pixels);
        let image = image.ok_or_else(|| CaptureError::invalid(&self.path, "has frames of another size"))?;
        state.keep(frame, image.clone());
        Ok(image)
    }

    /// Starts `ffmpeg` so that `frame` comes out first; without seeking, the first frame of all.
    fn start(&self, frame: usize, times: &Times) -> Result<Running, CaptureError> {
        let mut command = Command::new("ffmpeg");
        // Ctrl-C in a terminal must reach only this process, which may still need frames; by default it ends ffmpeg as
        // well.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        command.args(["-v", "error", "-nostdin", "-threads", "2", "-noautorotate"]);
        let frame = if self.can_seek { frame } else { 0 };
        if frame > 0 {
            // Between this frame and the previous one.
            let secs = 0.5 * (times.secs(frame - 1) + times.secs(frame)) - self.begin_secs;
            command.arg("-ss").arg(format!("{:.6}", secs.max(0.0)));
        }
        command.arg("-i").arg(in_place(&self.path)).args(["-map", "0:V:0"]).args(every_frame());
        command.args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-sws_flags", "bicubic+accurate_rnd+full_chroma_int"]);
        command.arg("pipe:1").stderr(Stdio::null());
        let failed = |error| CaptureError::invalid(&self.path, format!("cannot be decoded: ffmpeg: {error}"));
        let (program, stdout) = Program::start(&mut command).map_err(failed)?;
        Ok(Running { _program: program, frames: BufReader::new(stdout), next_frame: frame })
    }
}

impl State {
    fn keep(&mut self, frame: usize, image: RgbImage) {
        self.kept.push_back((frame, image));
        let mut bytes: usize = self.kept.iter().map(|(_, image)| image.as_raw().len()).sum();
        while bytes > KEPT_BYTES && self.kept.len() > 1 {
            bytes -= self.kept.pop_front().map_or(0, |(_, image)| image.as_raw().len());
        }
    }
}

/// The sound of a video, one channel, from the moment 0 of its clock on.
///
/// - `rate`: samples per second
/// - `max_secs`: maximum decoded length
/// - returns: samples in `[-1, 1]`; `None` if there is no sound, or no `ffmpeg`
pub fn audio(path: &Path, rate: u32, max_secs: f64) -> Option<Vec<f32>> {
    let mut command = Command::new("ffmpeg");
    command
        .args(["-v", "error", "-nostdin", "-i"])
        .arg(in_place(path))
        .args(["-map", "0:a:0", "-vn", "-ac", "1", "-t", &max_secs.to_string()])
        // Sound that begins late is preceded by silence, so that both clocks agree.
        .args(["-af", &format!("aresample={rate}:async=1:first_pts=0"), "-f", "s16le", "pipe:1"]);
    // Two bytes a sample, and some slack.
    let max_bytes = 2 * (f64::from(rate) * (max_secs + 1.0)) as u64;
    let (is_sound, sound, _) = Program::output(&mut command, max_bytes).ok()?;
    let samples: Vec<f32> =
        sound.as_chunks::<2>().0.iter().map(|&bytes| f32::from(i16::from_le_bytes(bytes)) / 32768.0).collect();
    (is_sound && !samples.is_empty()).then_some(samples)
}

/// The option to output every frame once, whatever its time. Versions before 5.1 have another name for it.
fn every_frame() -> [&'static str; 2] {
    static OPTION: OnceLock<[&str; 2]> = OnceLock::new();
    *OPTION.get_or_init(|| {
        let output = Program::output(Command::new("ffmpeg").arg("-version"), MAX_PROBE_BYTES);
        let text = output.map(|(_, text, _)| String::from_utf8_lossy(&text).into_owned()).unwrap_or_default();
        let version = text.strip_prefix("ffmpeg version ").unwrap_or_default();
        let mut parts = version.trim_start_matches('n').split(|c: char| !c.is_ascii_digit());
        let mut part = || parts.next().and_then(|part| part.parse::<u32>().ok());
        match (part(), part()) {
            (Some(major), minor) if (major, minor.unwrap_or(0)) < (5, 1) => ["-vsync", "passthrough"],
            _ => ["-fps_mode", "passthrough"],
        }
    })
}

/// A path that `ffmpeg` cannot mistake for an option or a protocol.
fn in_place(path: &Path) -> PathBuf {
    if path.is_absolute() { path.into() } else { Path::new(".").join(path) }
}

/// The last line of a program's output.
fn last_line(said: &[u8]) -> String {
    let text = String::from_utf8_lossy(said);
    text.lines().map(str::trim).rfind(|line| !line.is_empty()).unwrap_or("nothing").to_owned()
}
