//! The sound of the footage: that of one camera, cut to the capture's clock.

use std::path::Path;
use std::process::{Command, Stdio};

use tcgs_capture::{CaptureDescription, DESCRIPTION_FILE, DescribedCamera, audio};

use crate::output::write_file;

/// Samples per second by which cameras are compared.
const RATE: u32 = 8000;
/// Longest sound that is compared, seconds.
const MAX_SECS: f64 = 600.0;
/// Samples of a moment whose loudness counts: a twentieth of a second.
const MOMENT: usize = RATE as usize / 20;
/// Mean square below which a moment is silent.
const SILENCE: f32 = 1e-8;
/// Level from which on a sample is overdriven, and the share of such samples that rules a camera out.
const OVERDRIVEN: (f32, f32) = (0.99, 0.001);
const BITRATE: &str = "96k";

/// Writes the sound of the camera with the best signal as Ogg Opus. Without sound or `ffmpeg` no file is written, and
/// the line says so.
///
/// - returns: the result in words
pub fn take(capture: &Path, out: &Path) -> anyhow::Result<String> {
    let line = |text: String| Ok(format!("sound: {text}"));
    let file = capture.join(DESCRIPTION_FILE);
    if !file.exists() {
        return line("none, since the capture is not of videos".into());
    }
    let description = CaptureDescription::read(&file)?;
    let secs = description.num_frames as f64 / description.frame_rate;
    let heard = description.cameras.iter().filter_map(|camera| Some((camera, clarity(capture, camera, secs)?)));
    let Some((camera, _)) = heard.max_by(|(_, a), (_, b)| a.total_cmp(b)) else {
        return line("none: no video has any, or ffmpeg is not installed".into());
    };
    match encode(&capture.join(&camera.file), camera.start_secs, secs) {
        Ok(sound) => {
            write_file(out, &sound, false)?;
            line(format!("that of {}, {secs:.1} s", camera.name))
        }
        Err(problem) => line(format!("none: ffmpeg: {problem}")),
    }
}

/// By how much the loud moments of a camera's sound exceed the quiet ones, as a logarithm. None without sound.
fn clarity(capture: &Path, camera: &DescribedCamera, secs: f64) -> Option<f32> {
    let begin = camera.start_secs.max(0.0);
    let samples = audio(&capture.join(&camera.file), RATE, (begin + secs).min(MAX_SECS))?;
    let used = samples.get((begin * f64::from(RATE)) as usize..)?;
    clarity_of(used)
}

fn clarity_of(samples: &[f32]) -> Option<f32> {
    let (level, most) = OVERDRIVEN;
    let overdriven = samples.iter().filter(|sample| sample.abs() > level).count() as f32;
    let mut loudness: Vec<f32> = samples
        .chunks_exact(MOMENT)
        .map(|moment| moment.iter().map(|sample| sample * sample).sum::<f32>() / MOMENT as f32)
        .collect();
    loudness.sort_by(f32::total_cmp);
    let last = loudness.len().checked_sub(1)?;
    let at = |share: f32| loudness[(share * last as f32) as usize].max(SILENCE);
    if loudness[last] <= SILENCE {
        return None;
    }
    let penalty = if overdriven > most * samples.len() as f32 { 100.0 } else { 0.0 };
    Some((at(0.95) / at(0.05)).ln() - penalty)
}

/// The bytes of an Ogg Opus file.
fn encode(video: &Path, begin: f64, secs: f64) -> Result<Vec<u8>, String> {
    let cut = format!("aresample=48000:async=1:first_pts=0,atrim=start={begin}:duration={secs},asetpts=PTS-STARTPTS");
    let output = Command::new("ffmpeg")
        .args(["-v", "error", "-nostdin", "-i"])
        .arg(std::path::absolute(video).map_err(|error| error.to_string())?)
        .args(["-map", "0:a:0", "-vn", "-map_metadata", "-1", "-af", &cut, "-c:a", "libopus", "-b:a", BITRATE])
        .args(["-f", "ogg", "pipe:1"])
        .stdin(Stdio::null())
        .output()
        .map_err(|error| error.to_string())?;
    let said = String::from_utf8_lossy(&output.stderr);
    let problem = || said.lines().last().unwrap_or("failed").to_owned();
    if output.status.success() { Ok(output.stdout) } else { Err(problem()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clear_sound_beats_noise_silence_and_overdriven_sound() {
        let seconds = |loud: f32, quiet: f32| -> Vec<f32> {
            let tone = |i: usize, level: f32| level * (0.7 * i as f32).sin();
            (0..4 * RATE as usize)
                .map(|i| tone(i, if (i / RATE as usize).is_multiple_of(2) { loud } else { quiet }))
                .collect()
        };
        let of = |loud, quiet| clarity_of(&seconds(loud, quiet));
        assert!(of(0.5, 0.01) > of(0.5, 0.2));
        assert!(of(0.5, 0.2) > of(1.0, 0.0));
        assert_eq!((of(0.0, 0.0), clarity_of(&[])), (None, None));
    }
}
