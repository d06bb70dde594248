//! Videos, frame by frame: MP4 files of H.264.
//!
//! What lives here: finding a frame and decoding up to it. `sps` reads how the stream is coded, `yuv` makes colours.
//! Frames are decoded in order and mostly asked for in order, so that each costs the decoding of one. A frame asked
//! for again is kept for a while; an earlier one is decoded again from the last place where that can begin.

mod sps;
mod yuv;

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::iter::repeat_n;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use image::RgbImage;
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use re_mp4::{Avc1Box, Mp4, StblBox, StsdBoxContent, TrackKind, TrakBox};

use crate::CaptureError;
use sps::Sps;

/// Bytes of decoded frames that a video keeps; the last one always.
const KEPT_BYTES: usize = 16 << 20;

/// What is said of other codecs.
const EXPECTED: &str =
    "expected H.264 of 8 bits, 4:2:0, such as `ffmpeg -i IN -c:v libx264 -crf 12 -pix_fmt yuv420p OUT.mp4` writes";

/// A video of one camera.
pub(crate) struct Video {
    path: PathBuf,
    size: (usize, usize),
    frame_rate: f64,
    /// By frame in the order of showing: seconds, without what edit lists change.
    times_secs: Vec<f64>,
    shown: Shown,
    /// In the order of decoding.
    samples: Vec<Sample>,
    /// By frame in the order of showing: where decoding may begin at the latest.
    begins: Vec<usize>,
    stream: Stream,
    state: Mutex<DecoderState>,
}

/// What a player does with the frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shown {
    /// Clockwise quarter turns.
    pub quarter_turns: u8,
    /// What is added to the times of frames, seconds.
    pub shift_secs: f64,
    /// From which moment on nothing is shown, seconds after the shift. What comes before 0 is not shown either.
    pub end_secs: f64,
}

/// One coded frame.
#[derive(Clone, Debug)]
struct Sample {
    bytes: Range<u64>,
    /// Place in the order of showing.
    shown: usize,
    /// Whether nothing before it is needed.
    begins: bool,
}

/// How the frames are coded.
struct Stream {
    /// Parameter sets, each after a start code.
    head: Vec<u8>,
    /// Bytes of the length before each unit.
    length_bytes: usize,
    color: yuv::ColorSpace,
}

#[derive(Default)]
struct DecoderState {
    running: Option<Running>,
    /// The latest last.
    kept: VecDeque<(usize, RgbImage)>,
}

/// A decoder on its way.
struct Running {
    decoder: Decoder,
    file: File,
    /// Next to be decoded.
    next_sample: usize,
    /// Next to come out.
    next_frame: usize,
}

impl Video {
    /// Reads all but the frames.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        Self::open_if_known(path)?.map_err(|problem| CaptureError::invalid(path, problem))
    }

    /// Reads all but the frames, if the video is of the codec that is built in.
    ///
    /// - returns: what is wrong and what was expected, if another program may still read the video
    pub fn open_if_known(path: &Path) -> Result<Result<Self, String>, CaptureError> {
        let failed = |error| CaptureError::Io { path: path.into(), error };
        let invalid = |problem: String| CaptureError::invalid(path, problem);
        let file = File::open(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        // Its reader trusts the tables of a file, and those of a damaged one do not fit together.
        let mp4 = catch_unwind(AssertUnwindSafe(|| Mp4::read(BufReader::new(file), file_bytes)))
            .map_err(|_| invalid("is damaged: its tables contradict each other, expected an MP4 file".into()))?
            .map_err(|error| invalid(format!("cannot be read: {error}, expected a whole MP4 file")))?;
        let track = mp4.tracks().values().find(|track| track.kind == Some(TrackKind::Video));
        // A codec that its reader does not know is taken for no video.
        let Some(track) = track else { return Ok(Err("has no video, expected an MP4 file of one".into())) };
        let StsdBoxContent::Avc1(avc) = &track.trak(&mp4).mdia.minf.stbl.stsd.contents else {
            let codec = track.codec_string(&mp4).unwrap_or_else(|| "unknown".into());
            return Ok(Err(format!("has the codec {codec}, {EXPECTED}")));
        };
        let stream = match Stream::new(avc) {
            Ok(stream) => stream,
            Err(problem) => return Ok(Err(format!("{problem}, {EXPECTED}"))),
        };
        if track.samples.is_empty() {
            return Err(invalid("has no frames, expected at least one".into()));
        }
        let mut shown: Vec<usize> = (0..track.samples.len()).collect();
        shown.sort_by_key(|&sample| track.samples[sample].composition_timestamp);
        let mut samples: Vec<Sample> = track
            .samples
            .iter()
            .map(|s| Sample { bytes: s.offset..s.offset.saturating_add(s.size), shown: 0, begins: s.is_sync })
            .collect();
        for (frame, &sample) in shown.iter().enumerate() {
            samples[sample].shown = frame;
        }
        if let Some(frame) = samples.iter().position(|sample| sample.bytes.end > file_bytes) {
            return Err(invalid(format!("ends inside its frame {frame}, expected {} frames", samples.len())));
        }
        samples[0].begins = true;
        let mut begins = vec![0; samples.len()];
        let mut last = 0;
        for (frame, &sample) in shown.iter().enumerate() {
            // From a frame on which nothing earlier depends what is shown later can be decoded.
            if samples[sample].begins && sample >= last {
                last = sample;
            }
            begins[frame] = last;
        }
        let seconds = track.duration as f64 / track.timescale.max(1) as f64;
        let frame_rate = if seconds > 0.0 { samples.len() as f64 / seconds } else { 0.0 };
        let timescale = track.timescale.max(1) as f64;
        let time = |&sample: &usize| track.samples[sample].composition_timestamp as f64 / timescale;
        let times_secs = shown.iter().map(time).collect();
        let size = (usize::from(avc.width), usize::from(avc.height));
        let shown = shown_of(track.trak(&mp4), timescale, f64::from(mp4.moov.mvhd.timescale.max(1)));
        let (path, state) = (path.into(), Mutex::default());
        Ok(Ok(Self { path, size, frame_rate, times_secs, shown, samples, begins, stream, state }))
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Frames a second, 0 if unknown.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    pub fn num_frames(&self) -> usize {
        self.samples.len()
    }

    /// By frame in the order of showing: seconds, before [`Self::shown`] changes anything.
    pub fn times_secs(&self) -> &[f64] {
        &self.times_secs
    }

    /// How a player shows the frames.
    pub fn shown(&self) -> Shown {
        self.shown
    }

    /// Decodes a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn frame(&self, frame: usize) -> Result<RgbImage, CaptureError> {
        assert!(frame < self.num_frames(), "frame {frame} of {}", self.num_frames());
        // A decoder that panicked is thrown away with what it left.
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
        // The last few come together, and the decoder is of no further use.
        let rest = running.decoder.flush_remaining();
        for picture in rest.map_err(|error| failed(format!("cannot be decoded: {error}")))? {
            take(&picture, &mut running.next_frame)?;
        }
        let (found, expected) = (running.next_frame, self.num_frames());
        wanted.ok_or_else(|| failed(format!("cannot be decoded: {found} of {expected} frames came out")))
    }

    /// A decoder that is given a sample next.
    fn begin(&self, sample: usize) -> Result<Running, CaptureError> {
        let failed = |error| CaptureError::Io { path: self.path.clone(), error };
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|error| CaptureError::invalid(&self.path, format!("no decoder for it: {error}")))?;
        let file = File::open(&self.path).map_err(failed)?;
        Ok(Running { decoder, file, next_sample: sample, next_frame: self.samples[sample].shown })
    }

    /// A sample's units, each after a start code instead of its length; before the first parameter sets.
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

/// What the header of a track says about turning its pictures, and its edit list about their times.
///
/// ISO/IEC 14496-12, 8.3.2 and 8.6.6. Of several edits the first that shows something counts.
fn shown_of(track: &TrakBox, timescale: f64, movie_timescale: f64) -> Shown {
    let matrix = &track.tkhd.matrix;
    let quarter_turns = match (matrix.a.signum(), matrix.b.signum()) {
        (0, 1) => 1,
        (-1, 0) => 2,
        (0, -1) => 3,
        _ => 0,
    };
    let mut shown = Shown { quarter_turns, shift_secs: 0.0, end_secs: f64::INFINITY };
    let edits = track.edts.as_ref().and_then(|edits| edits.elst.as_ref());
    for edit in edits.map_or(&[][..], |list| &list.entries) {
        let secs = edit.segment_duration as f64 / movie_timescale;
        // An empty edit has the media time -1, in 32 or 64 bits: nothing is shown for so long.
        if edit.media_time == u64::from(u32::MAX) || edit.media_time == u64::MAX {
            shown.shift_secs += secs;
            continue;
        }
        // A duration of 0 stands for all there is. Times of the movie are coarser than those of frames, and rounded.
        if edit.segment_duration > 0 {
            shown.end_secs = shown.shift_secs + secs;
        }
        shown.shift_secs -= edit.media_time as f64 / timescale;
        break;
    }
    // The reader lets the first frame begin at 0; edits count from before that.
    shown.shift_secs += first_composition(&track.mdia.minf.stbl) as f64 / timescale;
    shown
}

/// The least time of any frame, as the tables have it.
fn first_composition(tables: &StblBox) -> i64 {
    let Some(offsets) = &tables.ctts else { return 0 };
    let offsets =
        offsets.entries.iter().flat_map(|run| repeat_n(i64::from(run.sample_offset), run.sample_count as usize));
    let durations = tables.stts.entries.iter();
    let durations = durations.flat_map(|run| repeat_n(i64::from(run.sample_delta), run.sample_count as usize));
    let mut begin = 0;
    let times = durations.zip(offsets).map(|(duration, offset)| {
        begin += duration;
        begin - duration + offset
    });
    times.min().unwrap_or(0)
}

/// ITU-T H.264, annex B.
const START_CODE: [u8; 4] = [0, 0, 0, 1];

impl Stream {
    fn new(avc: &Avc1Box) -> Result<Self, String> {
        let avcc = &avc.avcc;
        let first = avcc.sequence_parameter_sets.first().ok_or("has no sequence parameter set")?;
        let sps = Sps::parse(&first.bytes).ok_or("has a damaged sequence parameter set")?;
        sps.check()?;
        let sets = avcc.sequence_parameter_sets.iter().chain(&avcc.picture_parameter_sets);
        let head = sets.flat_map(|set| START_CODE.into_iter().chain(set.bytes.iter().copied())).collect();
        Ok(Self { head, length_bytes: usize::from(avcc.length_size_minus_one & 3) + 1, color: sps.color })
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
