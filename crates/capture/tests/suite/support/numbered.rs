//! Videos whose frames show their numbers, so that no frame can be taken for another. Made by the program `ffmpeg`.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

use image::{Rgb, RgbImage};

pub const WIDTH: u32 = 128;
pub const HEIGHT: u32 = 64;
/// Bits of a number, each a block of the picture; the last block is always white and marks the upper side.
const BITS: u32 = 7;
const BLOCK: u32 = WIDTH / (BITS + 1);
/// Frames per second.
pub const RATE: &str = "20";
pub const H264: &[&str] = &["-c:v", "libx264", "-bf", "2", "-g", "12", "-pix_fmt", "yuv420p"];

/// A picture that shows its number as bits in the upper half.
pub fn numbered(number: usize) -> RgbImage {
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        let bit = x / BLOCK;
        let lit = y < HEIGHT / 2 && (bit == BITS || number >> bit & 1 == 1);
        Rgb(if lit { [230; 3] } else { [40; 3] })
    })
}

/// The number that a picture shows.
pub fn number_of(image: &tcgs_core::Image) -> usize {
    assert_eq!((image.width, image.height), (WIDTH as usize, HEIGHT as usize));
    let lit = |bit: u32| {
        let (x, y) = ((bit * BLOCK + BLOCK / 2) as usize, (HEIGHT / 4) as usize);
        image.data[y * image.width + x] > 0.5
    };
    assert!(lit(BITS), "not the right way up");
    (0..BITS).map(|bit| usize::from(lit(bit)) << bit).sum()
}

/// Runs `ffmpeg` with pictures of these numbers as its first input.
pub fn encode(numbers: impl Iterator<Item = usize>, arguments: &[&str], out: &Path) {
    let size = format!("{WIDTH}x{HEIGHT}");
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", &size, "-r", RATE, "-i", "pipe:0"]);
    let mut child = command.args(arguments).arg(out).stdin(Stdio::piped()).spawn().unwrap();
    let mut pipe = child.stdin.take().unwrap();
    for number in numbers {
        pipe.write_all(numbered(number).as_raw()).unwrap();
    }
    drop(pipe);
    assert!(child.wait().unwrap().success(), "{arguments:?}");
}

/// Runs `ffmpeg` on a file.
pub fn convert(from: &Path, arguments: &[&str], out: &Path) {
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-y", "-i"]).arg(from).args(arguments).arg(out).stdin(Stdio::null());
    assert!(command.status().unwrap().success(), "{arguments:?}");
}
