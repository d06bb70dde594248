//! Encodes pictures as a video with the program `ffmpeg`.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::{self, JoinHandle};

use anyhow::{Context, anyhow};
use tcgs_interchange::Unfinished;

use crate::error::wrong_input;
use crate::interrupt;
use crate::options::Size;
use crate::output::{begin_beside, write_file_with};

/// Frame rate of a scene that declares none.
const FRAME_RATE: f64 = 30.0;

/// Encoder options of each file type: close to visually lossless.
const MP4: &[&str] = &["-c:v", "libx264", "-preset", "medium", "-crf", "16", "-movflags", "+faststart"];
const WEBM: &[&str] = &["-c:v", "libvpx-vp9", "-crf", "20", "-b:v", "0", "-row-mt", "1"];
/// 8 bits, 4:2:0 chroma and BT.709, which browsers and televisions play; 4:2:0 needs even sides.
const SHOWN_ANYWHERE: &[&str] = &[
    "-vf",
    "crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0,scale=out_color_matrix=bt709:out_range=tv",
    "-pix_fmt",
    "yuv420p",
    "-colorspace",
    "bt709",
    "-color_primaries",
    "bt709",
    "-color_trc",
    "bt709",
    "-color_range",
    "tv",
];

/// A video being written.
pub struct Video {
    place: PathBuf,
    force: bool,
    frame_rate: f64,
    encoder: &'static [&'static str],
    /// Beside the output: with the same access rights, and cleaned up by the same rule if this process is killed.
    folder: Unfinished,
    running: Option<Running>,
}

/// A running `ffmpeg`.
struct Running {
    child: Child,
    size: Size,
    /// Reads its standard error.
    said: JoinHandle<String>,
}

/// The encoder options for a file name; `None` if its ending is not that of a video.
fn encoder(place: &Path) -> Option<&'static [&'static str]> {
    match ending(place).as_str() {
        "mp4" => Some(MP4),
        "webm" => Some(WEBM),
        _ => None,
    }
}

fn ending(place: &Path) -> String {
    place.extension().and_then(OsStr::to_str).unwrap_or_default().to_ascii_lowercase()
}

/// Whether the output is a video.
pub fn is_named(place: &Path) -> bool {
    encoder(place).is_some()
}

impl Video {
    /// Begins a video if the ending of the output is that of one. `ffmpeg` must be installed.
    pub fn begin(place: &Path, force: bool) -> anyhow::Result<Option<Self>> {
        let Some(encoder) = encoder(place) else {
            let ending = ending(place);
            if ["avi", "gif", "mkv", "mov"].contains(&&*ending) {
                let problem = format!("no .{ending} here, expected .mp4, .webm or the name of a folder for PNG files");
                return Err(wrong_input(format!("{}: {problem}", place.display())));
            }
            return Ok(None);
        };
        let found = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).status();
        if let Err(error) = found {
            let way_out = "expected it on the PATH for a video; PNG frames need none: --out FOLDER";
            return Err(anyhow!("ffmpeg: {error}, {way_out}"));
        }
        let folder = begin_beside(place).context("making a folder for the video")?;
        Ok(Some(Self { place: place.into(), force, frame_rate: FRAME_RATE, encoder, folder, running: None }))
    }

    /// Sets the number of frames per second; 0 if unknown.
    pub fn set_frame_rate(&mut self, frame_rate: f64) {
        if frame_rate > 0.0 {
            self.frame_rate = frame_rate;
        }
    }

    /// Appends a picture.
    ///
    /// - `rgb`: `[H, W, 3]`
    /// - `size`: the same for all pictures
    pub fn add(&mut self, rgb: &[u8], size: Size) -> anyhow::Result<()> {
        let expected = match &self.running {
            Some(running) => running.size,
            None => {
                self.running = Some(self.start(size)?);
                size
            }
        };
        if size != expected {
            let (found, expected) = [size, expected].map(|s| format!("{}x{}", s.width, s.height)).into();
            let problem = format!("pictures of {found} after such of {expected}, expected one size: --size");
            return Err(wrong_input(format!("{}: {problem}", self.place.display())));
        }
        let pipe = self.running.as_mut().and_then(|running| running.child.stdin.as_mut());
        match pipe.map_or(Ok(()), |pipe| pipe.write_all(rgb)) {
            Ok(()) => Ok(()),
            Err(_) => self.end(),
        }
    }

    /// Moves the video to its place.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.end()?;
        let mut made = File::open(self.made()).with_context(|| format!("reading {}", self.made().display()))?;
        write_file_with(&self.place, self.force, |mut file| io::copy(&mut made, &mut file).map(drop))
    }

    fn start(&self, size: Size) -> anyhow::Result<Running> {
        let mut command = Command::new("ffmpeg");
        // A process group of its own: Ctrl-C in a terminal then reaches only this process, which ends the encoder.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let started = command
            .args(["-loglevel", "error", "-nostdin", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args([
                "-s",
                &format!("{}x{}", size.width, size.height),
                "-r",
                &self.frame_rate.to_string(),
                "-i",
                "pipe:0",
            ])
            .args(SHOWN_ANYWHERE)
            .args(self.encoder)
            .arg(self.made())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = started.context("starting ffmpeg")?;
        interrupt::pass_on_to(Some(&child));
        let stderr = child.stderr.take();
        let said = thread::spawn(move || {
            let mut said = Vec::new();
            // A pipe and not a file: the message may be about a full disk.
            let _ = stderr.map(|mut stderr| stderr.read_to_end(&mut said));
            String::from_utf8_lossy(&said).into_owned()
        });
        Ok(Running { child, size, said })
    }

    /// Waits until ffmpeg has written everything.
    fn end(&mut self) -> anyhow::Result<()> {
        let Some(Running { mut child, said, .. }) = self.running.take() else { return Ok(()) };
        drop(child.stdin.take());
        let status = child.wait().context("waiting for ffmpeg");
        interrupt::pass_on_to(None);
        let status = status?;
        if status.success() {
            return Ok(());
        }
        let said = said.join().unwrap_or_default();
        let said = said.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("nothing");
        Err(anyhow!("{}: ffmpeg ended with {status} and said: {said}", self.place.display()))
    }

    /// The temporary file; ffmpeg chooses the container by its ending.
    fn made(&self) -> PathBuf {
        self.folder.path().join("made").with_extension(self.place.extension().unwrap_or_default())
    }
}

impl Drop for Video {
    /// Kills a running encoder after an error elsewhere.
    fn drop(&mut self) {
        if let Some(Running { child, .. }) = &mut self.running {
            let _ = child.kill();
            let _ = child.wait();
            interrupt::pass_on_to(None);
        }
    }
}
