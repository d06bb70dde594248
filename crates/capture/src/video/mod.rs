//! Videos, frame by frame: MP4 files of H.264.
//!
//! What lives here: finding a frame and decoding up to it. `mp4` lists the frames of a file, `sps` reads the coding of
//! the stream, `yuv` converts colours.
//!
//! Frames are decoded in order. In sequential access each is decoded once. Decoded frames are kept for a while. An
//! earlier frame is decoded again from the last key frame before it.

mod mp4;
mod sps;
mod yuv;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use image::RgbImage;
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use tcgs_core::open_file;

use crate::CaptureError;
use mp4::{Avc, Mp4Error, Track};
use sps::Sps;

/// Bytes of decoded frames that a video keeps; the last frame is always kept.
const KEPT_BYTES: usize = 16 << 20;

/// Second half of the message about other codecs.
const EXPECTED: &str =
    "expected H.264 of 8 bits, 4:2:0, such as `ffmpeg -i IN -c:v libx264 -crf 12 -pix_fmt yuv420p OUT.mp4` writes";

/// A video of one camera.
pub(crate) struct Video {
    path: PathBuf,
    size: (usize, usize),
    frame_rate: f64,
    /// Seconds by frame in presentation order, before edit lists.
    times_secs: Vec<f64>,
    shown: Shown,
    /// In decoding order.
    samples: Vec<Sample>,
    /// By frame in presentation order: the latest sample at which decoding may begin.
    begins: Vec<usize>,
    stream: Stream,
    state: Mutex<DecoderState>,
}

/// Presentation of the frames by a player.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shown {
    /// Clockwise quarter turns.
    pub quarter_turns: u8,
    /// Added to the times of frames, seconds.
    pub shift_secs: f64,
    /// End of the presentation, seconds after the shift. Frames before 0 are not shown either.
    pub end_secs: f64,
}

/// One coded frame.
#[derive(Clone, Debug)]
struct Sample {
    bytes: Range<u64>,
    /// Index in presentation order.
    shown: usize,
    /// Whether it decodes without earlier frames.
    begins: bool,
}

/// Coding parameters of the frames.
struct Stream {
    /// Parameter sets, each after a start code.
    head: Vec<u8>,
    /// Length in bytes of the size before each unit.
    length_bytes: usize,
    color: yuv::ColorSpace,
}

#[derive(Default)]
struct DecoderState {
    running: Option<Running>,
    /// Latest last.
    kept: VecDeque<(usize, RgbImage)>,
}

/// A decoder in progress.
struct Running {
    decoder: Decoder,
    file: File,
    /// The next sample to be decoded.
    next_sample: usize,
    /// The next frame to come out.
    next_frame: usize,
}

impl Video {
    /// Reads everything but the frames.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        Self::open_if_known(path)?.map_err(|problem| CaptureError::invalid(path, problem))
    }

    /// Reads everything but the frames, if the built-in decoder knows the codec.
    ///
    /// - returns: found and expected, if another program may still read the video
    pub fn open_if_known(path: &Path) -> Result<Result<Self, String>, CaptureError> {
        let failed = |error| CaptureError::Io { path: path.into(), error };
        let invalid = |problem: String| CaptureError::invalid(path, problem);
        let file = open_file(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        let track = mp4::read(BufReader::new(file), file_bytes).map_err(|error| match error {
            Mp4Error::Io(error) => failed(error),
            Mp4Error::Format(problem) => invalid(format!("cannot be read: {problem}, expected a whole MP4 file")),
        })?;
        let Some(track) = track else { return Ok(Err("has no video, expected an MP4 file of one".into())) };
        let Some(avc) = &track.avc else {
            return Ok(Err(format!("has the codec {}, {EXPECTED}", track.codec)));
        };
        let stream = match Stream::new(avc) {
            Ok(stream) => stream,
            Err(problem) => return Ok(Err(format!("{problem}, {EXPECTED}"))),
        };
        if track.samples.is_empty() {
            return Err(invalid("has no frames, expected at least one".into()));
        }
        let mut shown: Vec<usize> = (0..track.samples.len()).collect();
        shown.sort_by_key(|&sample| track.samples[sample].composed);
        let mut samples: Vec<Sample> =
            track.samples.iter().map(|s| Sample { bytes: s.bytes.clone(), shown: 0, begins: s.begins }).collect();
        for (frame, &sample) in shown.iter().enumerate() {
            samples[sample].shown = frame;
        }
        if let Some(frame) = samples.iter().position(|sample| sample.bytes.end > file_bytes) {
            return Err(invalid(format!("ends inside its frame {frame}, expected {} frames", samples.len())));
        }
        let all_bytes: u64 = samples.iter().map(|sample| sample.bytes.end - sample.bytes.start).sum();
        if all_bytes > file_bytes {
            return Err(invalid("cannot be read: its frames overlap, expected a whole MP4 file".into()));
        }
        samples[0].begins = true;
        let mut begins = vec![0; samples.len()];
        let mut last = 0;
        for (frame, &sample) in shown.iter().enumerate() {
            // From a frame without earlier dependencies on, all later-shown frames can be decoded.
            if samples[sample].begins && sample >= last {
                last = sample;
            }
            begins[frame] = last;
        }
        let timescale = f64::from(track.timescale.max(1));
        let seconds = track.duration as f64 / timescale;
        let frame_rate = if seconds > 0.0 { samples.len() as f64 / seconds } else { 0.0 };
        // The first frame is at 0; edits count from an earlier origin.
        let first = track.samples[shown[0]].composed;
        let time = |&sample: &usize| track.samples[sample].composed.saturating_sub(first) as f64 / timescale;
        let times_secs = shown.iter().map(time).collect();
        let size = (usize::from(avc.width), usize::from(avc.height));
        let mut shown = shown_of(&track);
        shown.shift_secs += first as f64 / timescale;
        let (path, state) = (path.into(), Mutex::default());
        Ok(Ok(Self { path, size, frame_rate, times_secs, shown, samples, begins, stream, state }))
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Frames per second, 0 if unknown.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    pub fn num_frames(&self) -> usize {
        self.samples.len()
    }

    /// Seconds by frame in presentation order, before the changes of [`Self::shown`].
    pub fn times_secs(&self) -> &[f64] {
        &self.times_secs
    }

    /// Presentation of the frames by a player.
    pub fn shown(&self) -> Shown {
        self.shown
    }

    /// Decodes a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn frame(&self, frame: usize) -> Result<RgbImage, CaptureError> {
        assert!(frame < self.num_frames(), "frame {frame} of {}", self.num_frames());
        // A decoder that panicked is dropped with its state.
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, image)) = state.kept.iter().find(|(kept, _)| *kept == frame) {
            return Ok(image.clone());
        }
        let result = self.decode(&mut state, frame);
        if result.is_err() {
            state.running = None;
        }
        result
    }

    fn decode(&self, state: &mut DecoderState, frame: usize) -> Result<RgbImage, CaptureError> {
        let failed = |problem: String| CaptureError::invalid(&self.path, format!("frame {frame}: {problem}"));
        let begin = self.begins[frame];
        let goes_on = |r: &Running| r.next_frame <= frame && begin <= r.next_sample;
        let mut running = match state.running.take().filter(goes_on) {
            Some(running) => running,
            None => self.begin(begin)?,
        };
        let mut wanted = None;
        let mut take = |picture: &DecodedYUV<'_>, next_frame: &mut usize| {
            if *next_frame >= frame {
                let image = yuv::to_rgb(picture, self.size, self.stream.color).map_err(failed)?;
                if *next_frame == frame {
                    wanted = Some(image.clone());
                }
                state.keep(*next_frame, image);
            }
            *next_frame += 1;
            Ok::<bool, CaptureError>(*next_frame > frame)
        };
        let mut packet = Vec::new();
        while let Some(sample) = self.samples.get(running.next_sample) {
            self.read(&mut running, sample, &mut packet)?;
            running.next_sample += 1;
            let decoded = running.decoder.decode(&packet);
            let picture = decoded.map_err(|error| failed(format!("cannot be decoded: {error}")))?;
            if let Some(picture) = picture
                && take(&picture, &mut running.next_frame)?
            {
                state.running = Some(running);
                return wanted.ok_or_else(|| failed("did not come out".into()));
            }
        }
        // The last few frames come together, and the decoder ends.
        let rest = running.decoder.flush_remaining();
        for picture in rest.map_err(|error| failed(format!("cannot be decoded: {error}")))? {
            take(&picture, &mut running.next_frame)?;
        }
        let (found, expected) = (running.next_frame, self.num_frames());
        wanted.ok_or_else(|| failed(format!("cannot be decoded: {found} of {expected} frames came out")))
    }

    /// Makes a decoder that gets `sample` next.
    fn begin(&self, sample: usize) -> Result<Running, CaptureError> {
        let failed = |error| CaptureError::Io { path: self.path.clone(), error };
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|error| CaptureError::invalid(&self.path, format!("no decoder for it: {error}")))?;
        let file = open_file(&self.path).map_err(failed)?;
        Ok(Running { decoder, file, next_sample: sample, next_frame: self.samples[sample].shown })
    }

    /// Reads a sample's units, each after a start code instead of its size. The parameter sets precede the first
    /// sample.
    fn read(&self, running: &mut Running, sample: &Sample, packet: &mut Vec<u8>) -> Result<(), CaptureError> {
        let mut coded = vec![0; (sample.bytes.end - sample.bytes.start) as usize];
        let from = &mut running.file;
        from.seek(SeekFrom::Start(sample.bytes.start))
            .and_then(|_| from.read_exact(&mut coded))
            .map_err(|error| CaptureError::Io { path: self.path.clone(), error })?;
        packet.clear();
        if sample.begins {
            packet.extend(&self.stream.head);
        }
        let mut rest = &coded[..];
        while !rest.is_empty() {
            let unit = rest.split_at_checked(self.stream.length_bytes).and_then(|(length, after)| {
                let length = length.iter().fold(0, |value, &byte| value << 8 | usize::from(byte));
                after.split_at_checked(length)
            });
            let Some((unit, after)) = unit else {
                return Err(CaptureError::invalid(&self.path, "is damaged: a frame ends inside a unit"));
            };
            packet.extend(START_CODE);
            packet.extend(unit);
            rest = after;
        }
        Ok(())
    }
}

/// Turn of a track's pictures from its header, and shift of their times from its edit list.
///
/// ISO/IEC 14496-12, 8.3.2 and 8.6.6. If there are several edits, the first one that shows pictures counts.
fn shown_of(track: &Track) -> Shown {
    let quarter_turns = match track.matrix.map(i32::signum) {
        [0, 1] => 1,
        [-1, 0] => 2,
        [0, -1] => 3,
        _ => 0,
    };
    let mut shown = Shown { quarter_turns, shift_secs: 0.0, end_secs: f64::INFINITY };
    for edit in &track.edits {
        let secs = edit.duration as f64 / f64::from(track.movie_timescale.max(1));
        let Some(begin) = edit.begin else {
            shown.shift_secs += secs;
            continue;
        };
        // A duration of 0 means the whole track. The movie's times are coarser than those of frames, and are rounded.
        if edit.duration > 0 {
            shown.end_secs = shown.shift_secs + secs;
        }
        shown.shift_secs -= begin as f64 / f64::from(track.timescale.max(1));
        break;
    }
    shown
}

/// ITU-T H.264, annex B.
const START_CODE: [u8; 4] = [0, 0, 0, 1];

impl Stream {
    fn new(avc: &Avc) -> Result<Self, String> {
        let first = avc.sequence_sets.first().ok_or("has no sequence parameter set")?;
        let sps = Sps::parse(first).ok_or("has a damaged sequence parameter set")?;
        sps.check()?;
        let sets = avc.sequence_sets.iter().chain(&avc.picture_sets);
        let head = sets.flat_map(|set| START_CODE.into_iter().chain(set.iter().copied())).collect();
        Ok(Self { head, length_bytes: avc.length_bytes, color: sps.color })
    }
}

impl DecoderState {
    fn keep(&mut self, frame: usize, image: RgbImage) {
        self.kept.push_back((frame, image));
        let mut bytes: usize = self.kept.iter().map(|(_, image)| image.as_raw().len()).sum();
        while bytes > KEPT_BYTES && self.kept.len() > 1 {
            bytes -= self.kept.pop_front().map_or(0, |(_, image)| image.as_raw().len());
        }
    }
}

impl std::fmt::Debug for Video {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Video").field("path", &self.path).field("frames", &self.num_frames()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
