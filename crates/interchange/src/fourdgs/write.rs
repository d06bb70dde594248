//! Writes a scene as a `.4dgs` file.

use ::fourdgs::quantization::{Profile, SH_QUANT_HI, SH_QUANT_LO};
use ::fourdgs::{GaussianSet, SceneExtras, WriteOptions};
use tcgs_core::{Attribute, Gaussians, normalize, sigmoid};

use super::{Y_UP, one_line};
use crate::axes::Axes;

/// The bytes of a `.4dgs` file, in its finest profile. Errors beyond the rounding of floats are at most 2 % of the
/// median scale in positions, 0.0005 in rotations, 0.5 % in scales. They are at most half of 1/255 in colours and
/// opacities, half of 8/255 in harmonics. Colours are clamped to the format's range, 0 to 1, harmonics to -4 to 4. The
/// axes are those of glTF, and the file says so. At `t = k / frame_rate`, and until the next, a reader sees timestep
/// `k`.
///
/// - `timesteps`: stored form, in the axes of PLY files, all of one layout. Their number of Gaussians may change; if it
///   does not, row `i` is the same Gaussian.
/// - `frame_rate`: above 0
/// - returns: the bytes, or an error: the first one of `timesteps`, or one line that names what the format cannot hold
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::fourdgs_bytes;
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
/// let bytes = fourdgs_bytes([Ok::<_, String>(gaussians)], 30.0)??;
/// assert_eq!(bytes[1..5], *b"4DGS");
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
/// Those of `timesteps`.
pub fn fourdgs_bytes<E>(
    timesteps: impl IntoIterator<Item = Result<Gaussians, E>>,
    frame_rate: f64,
) -> Result<Result<Vec<u8>, String>, E> {
    let mut set = GaussianSet::default();
    // The Gaussians of the timestep before, and the timestep since which none of their bits has changed.
    let mut alive: Option<(Gaussians, Vec<usize>)> = None;
    let mut count = 0;
    for gaussians in timesteps {
        let mut gaussians = gaussians?;
        Axes::LUF.turn(&mut gaussians);
        let born = match alive.take() {
            Some((before, born)) if before.num_gaussians() == gaussians.num_gaussians() => {
                let renewed = |(i, born): (usize, usize)| {
                    let is_same = is_same(&before, &gaussians, i);
                    if !is_same {
                        push(&mut set, &before, i, born, count, frame_rate);
                    }
                    if is_same { born } else { count }
                };
                born.into_iter().enumerate().map(renewed).collect()
            }
            other => {
                push_all(&mut set, other, count, frame_rate);
                vec![count; gaussians.num_gaussians()]
            }
        };
        set.sh_degree = gaussians.layout().sh_degree() as u8;
        alive = Some((gaussians, born));
        count += 1;
    }
    push_all(&mut set, alive, count, frame_rate);
    let degree = usize::from(set.sh_degree);
    set.sh_coefficients = (degree + 1) * (degree + 1) - 1;
    if degree == 0 {
        set.sh = None;
    }
    let library = concat!("tcgs ", env!("CARGO_PKG_VERSION"));
    let metadata = [("coordinate_system".into(), Y_UP.into())].into();
    // The crate's check allows 1e-9 beyond half a step, which is less than a float rounds: it would refuse most scenes.
    let options = WriteOptions {
        profile: Profile::Fine,
        verify: false,
        library: library.into(),
        metadata,
        ..WriteOptions::default()
    };
    let bytes = ::fourdgs::write_to_vec(&set, count as f64 / frame_rate, &options, &SceneExtras::default());
    Ok(bytes.map_err(|error| one_line(&error)))
}

/// Whether no bit of a Gaussian differs.
fn is_same(before: &Gaussians, now: &Gaussians, i: usize) -> bool {
    let row = |gaussians: &Gaussians, attribute: Attribute| {
        let components = attribute.components();
        let values = &gaussians.values(attribute)[i * components..(i + 1) * components];
        values.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
    };
    now.layout().attributes().all(|attribute| row(before, attribute) == row(now, attribute))
}

/// The largest float that is not above a time. A window that began later would show the timestep before.
fn not_above(time: f64) -> f32 {
    let nearest = time as f32;
    if f64::from(nearest) > time { nearest.next_down() } else { nearest }
}

fn push_all(set: &mut GaussianSet, alive: Option<(Gaussians, Vec<usize>)>, until: usize, frame_rate: f64) {
    let Some((gaussians, born)) = alive else { return };
    born.into_iter().enumerate().for_each(|(i, born)| push(set, &gaussians, i, born, until, frame_rate));
}

/// Appends a Gaussian that lives from one timestep up to another.
fn push(set: &mut GaussianSet, gaussians: &Gaussians, i: usize, from: usize, until: usize, frame_rate: f64) {
    let (from, until) = (from as f64 / frame_rate, until as f64 / frame_rate);
    set.positions.extend(gaussians.means()[i]);
    set.scales.extend(gaussians.log_scales()[i].map(f32::exp));
    let rotation = match normalize(gaussians.quats()[i]) {
        [0.0, 0.0, 0.0, 0.0] => [0.0, 0.0, 0.0, 1.0],
        [w, x, y, z] => [x, y, z, w],
    };
    set.rotations.extend(rotation);
    set.colors.extend(gaussians.colors()[i].map(|color| color.clamp(0.0, 1.0)));
    set.colors.push(sigmoid(gaussians.logit_opacities()[i]));
    set.motions.extend([0.0; 3]);
    set.mu_t.push(((from + until) / 2.0) as f32);
    set.sigma_t.push(f32::INFINITY);
    set.win_lo.push(not_above(from));
    set.win_hi.push(not_above(until));
    let byte = |x: f32| {
        let share = (f64::from(x) - SH_QUANT_LO) / (SH_QUANT_HI - SH_QUANT_LO);
        (share * 255.0).round().clamp(0.0, 255.0) as u8
    };
    let sh = set.sh.get_or_insert_default();
    for channel in 0..3 {
        for band in gaussians.layout().harmonics() {
            let row = &gaussians.values(band)[i * band.components()..][..band.components()];
            sh.extend(row.as_chunks::<3>().0.iter().map(|rgb| byte(rgb[channel])));
        }
    }
}
