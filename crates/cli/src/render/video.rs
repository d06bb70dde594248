//! Pictures to a video, by the program `ffmpeg`.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::{Context, anyhow};
use tcgs_interchange::Unfinished;

use crate::error::wrong_input;
use crate::options::Size;
use crate::output::{begin_beside, check_file, write_file_with};

/// Of a scene that does not say how many frames a second it has.
const FRAME_RATE: f64 = 30.0;

/// What each kind of file is encoded with: near to what the eye can tell from the pictures.
const MP4: &[&str] = &["-c:v", "libx264", "-preset", "medium", "-crf", "16", "-movflags", "+faststart"];
const WEBM: &[&str] = &["-c:v", "libvpx-vp9", "-crf", "20", "-b:v", "0", "-row-mt", "1"];
/// Browsers and televisions show 8 bits with halved chroma, which takes even sides, in the colours of BT.709.
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

/// A video in the making.
pub struct Video {
    place: PathBuf,
    force: bool,
    frame_rate: f64,
    encoder: &'static [&'static str],
    /// Beside the place: as private as that, and cleaned up by the same rule if this process is killed.
    folder: Unfinished,
    running: Option<(Child, Size)>,
}

impl Video {
    /// Begins a video, if the name of the output asks for one. `ffmpeg` has to be there.
    pub fn begin(place: &Path, force: bool) -> anyhow::Result<Option<Self>> {
        let ending = place.extension().and_then(OsStr::to_str).unwrap_or_default().to_ascii_lowercase();
        let encoder = match ending.as_str() {
            "mp4" => MP4,
            "webm" => WEBM,
            "avi" | "gif" | "mkv" | "mov" => {
                let problem = format!("no .{ending} here, expected .mp4, .webm or the name of a folder for PNG files");
                return Err(wrong_input(format!("{}: {problem}", place.display())));
            }
            _ => return Ok(None),
        };
        check_file(place, force)?;
        let found = Command::new("ffmpeg").arg("-version").stdin(Stdio::null()).stdout(Stdio::null()).status();
        if let Err(error) = found {
            let way_out = "expected it on the PATH for a video; PNG frames need none: --out FOLDER";
            return Err(anyhow!("ffmpeg: {error}, {way_out}"));
        }
        let folder = begin_beside(place).context("making a folder for the video")?;
        Ok(Some(Self { place: place.into(), force, frame_rate: FRAME_RATE, encoder, folder, running: None }))
    }

    /// Sets how many pictures pass a second; 0 if unknown.
    pub fn set_frame_rate(&mut self, frame_rate: f64) {
        if frame_rate > 0.0 {
            self.frame_rate = frame_rate;
        }
    }

    /// Adds a picture.
    ///
    /// - `rgb`: `[H, W, 3]`
    /// - `size`: the same for all
    pub fn add(&mut self, rgb: &[u8], size: Size) -> anyhow::Result<()> {
        let expected = match &self.running {
            Some((_, size)) => *size,
            None => {
                self.running = Some((self.start(size)?, size));
                size
            }
        };
        if size != expected {
            let (found, expected) = [size, expected].map(|s| format!("{}x{}", s.width, s.height)).into();
            let problem = format!("pictures of {found} after such of {expected}, expected one size: --size");
            return Err(wrong_input(format!("{}: {problem}", self.place.display())));
        }
        let pipe = self.running.as_mut().and_then(|(child, _)| child.stdin.as_mut());
        match pipe.map_or(Ok(()), |pipe| pipe.write_all(rgb)) {
            Ok(()) => Ok(()),
            Err(_) => self.end(),
        }
    }

    /// Puts it in its place.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.end()?;
        let mut made = File::open(self.made()).context("reading what ffmpeg wrote")?;
        write_file_with(&self.place, self.force, |mut file| io::copy(&mut made, &mut file).map(drop))
    }

    fn start(&self, size: Size) -> anyhow::Result<Child> {
        let log = File::create(self.log()).context("making a file for what ffmpeg says")?;
        Command::new("ffmpeg")
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
            .stderr(log)
            .spawn()
            .context("starting ffmpeg")
    }

    /// Waits until everything is written.
    fn end(&mut self) -> anyhow::Result<()> {
        let Some((mut child, _)) = self.running.take() else { return Ok(()) };
        drop(child.stdin.take());
        let status = child.wait().context("waiting for ffmpeg")?;
        if status.success() {
            return Ok(());
        }
        let log = fs::read_to_string(self.log()).unwrap_or_default();
        let said = log.lines().map(str::trim).find(|line| !line.is_empty()).unwrap_or("nothing");
        Err(anyhow!("{}: ffmpeg ended with {status} and said: {said}", self.place.display()))
    }

    /// The ending tells ffmpeg what to write.
    fn made(&self) -> PathBuf {
        self.folder.path().join("made").with_extension(self.place.extension().unwrap_or_default())
    }

    fn log(&self) -> PathBuf {
        self.folder.path().join("log.txt")
    }
}

impl Drop for Video {
    /// Nothing goes on after an error elsewhere.
    fn drop(&mut self) {
        if let Some((child, _)) = &mut self.running {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
