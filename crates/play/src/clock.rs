//! The clock of a player: which timestep is due.

/// Frames per second of a scene that does not say.
const DEFAULT_FRAME_RATE: f64 = 30.0;

/// A position in a scene's time that moves on at some speed, in a loop or not.
///
/// Positions are in timesteps: timestep `t` is due from position `t` up to, not including, `t + 1`.
///
/// ```
/// let mut clock = tcgs_play::Clock::new(24, 30.0);
/// clock.play();
/// clock.advance(1000.0);
/// clock.advance(1100.0);
/// assert_eq!(clock.timestep(), 3, "a tenth of a second at 30 timesteps a second");
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    num_timesteps: usize,
    frame_rate: f64,
    position: f64,
    is_playing: bool,
    is_looping: bool,
    speed: f64,
    last_ms: Option<f64>,
}

impl Clock {
    /// A clock that stands at the first timestep, set to loop at the scene's own speed.
    ///
    /// - `num_timesteps`: at least 1
    /// - `frame_rate`: timesteps a second; 0 if unknown, which counts as 30
    pub fn new(num_timesteps: usize, frame_rate: f64) -> Self {
        let frame_rate = if frame_rate > 0.0 { frame_rate } else { DEFAULT_FRAME_RATE };
        Self {
            num_timesteps,
            frame_rate,
            position: 0.0,
            is_playing: false,
            is_looping: true,
            speed: 1.0,
            last_ms: None,
        }
    }

    /// The timestep that is due.
    pub fn timestep(&self) -> usize {
        (self.position as usize).min(self.num_timesteps - 1)
    }

    /// The position in timesteps, from 0 up to, not including, their number.
    pub fn position(&self) -> f64 {
        self.position
    }

    /// Timesteps a second at speed 1.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    /// Whether time passes.
    pub fn is_playing(&self) -> bool {
        self.is_playing
    }

    /// Whether the speed is negative.
    pub fn is_backwards(&self) -> bool {
        self.speed < 0.0
    }

    /// Whether the first timestep follows the last one, and backwards the last one the first.
    pub fn is_looping(&self) -> bool {
        self.is_looping
    }

    /// Lets time pass. A clock without a loop that stands at the end begins at the start again.
    pub fn play(&mut self) {
        if !self.is_playing && !self.is_looping && self.num_timesteps > 1 {
            let last = self.num_timesteps - 1;
            match self.timestep() {
                0 if self.is_backwards() => self.seek(last),
                t if t == last && !self.is_backwards() => self.seek(0),
                _ => {}
            }
        }
        self.is_playing = true;
    }

    /// Stops time.
    pub fn pause(&mut self) {
        self.is_playing = false;
    }

    /// Goes to a timestep, or to the last timestep if there are fewer.
    pub fn seek(&mut self, timestep: usize) {
        self.position = timestep.min(self.num_timesteps - 1) as f64;
    }

    /// Stops time, and goes some timesteps on or back; beyond an end only in a loop.
    ///
    /// - `count`: timesteps; negative: back
    pub fn step(&mut self, count: i64) {
        self.is_playing = false;
        let (len, target) = (self.num_timesteps as i64, (self.timestep() as i64).saturating_add(count));
        self.seek(if self.is_looping { target.rem_euclid(len) } else { target.clamp(0, len - 1) } as usize);
    }

    /// Sets the speed.
    ///
    /// - `speed`: in multiples of the frame rate; negative: backwards; NaN and infinity change nothing
    pub fn set_speed(&mut self, speed: f64) {
        if speed.is_finite() {
            self.speed = speed;
        }
    }

    /// Sets whether the first timestep follows the last one, and backwards the last one the first.
    pub fn set_looping(&mut self, is_looping: bool) {
        self.is_looping = is_looping;
    }

    /// Moves the position on by the real time since the last call of this method or of [`Self::hold`].
    ///
    /// - `now_ms`: real time, milliseconds since an origin that never changes
    pub fn advance(&mut self, now_ms: f64) {
        let elapsed_ms = now_ms - self.last_ms.unwrap_or(now_ms);
        self.last_ms = Some(now_ms);
        if !self.is_playing || elapsed_ms.is_nan() || elapsed_ms <= 0.0 {
            return;
        }
        let end = self.num_timesteps as f64;
        let position = self.position + elapsed_ms * 1e-3 * self.frame_rate * self.speed;
        if (0.0..end).contains(&position) {
            self.position = position;
        } else if self.is_looping {
            // Rounding may give the end itself.
            let wrapped = position.rem_euclid(end);
            self.position = if wrapped < end { wrapped } else { 0.0 };
        } else {
            self.seek(if position < 0.0 { 0 } else { self.num_timesteps - 1 });
            self.is_playing = false;
        }
    }

    /// Lets real time pass without moving the position, as while a segment is missing.
    ///
    /// - `now_ms`: as for [`Self::advance`]
    pub fn hold(&mut self, now_ms: f64) {
        self.last_ms = Some(now_ms);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn playing() -> Clock {
        let mut clock = Clock::new(10, 20.0);
        clock.advance(1000.0);
        clock.play();
        clock
    }

    #[test]
    fn time_passes_at_the_frame_rate_and_speed() {
        let mut clock = playing();
        clock.advance(1049.0);
        assert_eq!(clock.timestep(), 0);
        clock.advance(1051.0);
        assert_eq!(clock.timestep(), 1);
        clock.set_speed(0.5);
        clock.set_speed(f64::NAN);
        clock.advance(1151.0);
        assert_eq!(clock.timestep(), 2);
        clock.hold(5000.0);
        clock.advance(5050.0);
        assert!((clock.position() - 2.52).abs() < 1e-9, "{}", clock.position());
        // A clock of the world that goes back does not.
        clock.advance(4000.0);
        assert!((clock.position() - 2.52).abs() < 1e-9);
    }

    #[test]
    fn a_loop_goes_around_either_end() {
        let mut clock = playing();
        clock.advance(1525.0);
        assert_eq!(clock.timestep(), 0);
        assert!((clock.position() - 0.5).abs() < 1e-9);
        clock.set_speed(-1.0);
        clock.advance(1600.0);
        assert_eq!(clock.timestep(), 9);
        // A tab that was away for a day.
        clock.advance(86_400_000.0);
        assert!(clock.timestep() < 10 && clock.is_playing());
    }

    #[test]
    fn without_a_loop_it_stops_at_the_end_and_play_starts_again() {
        let mut clock = playing();
        clock.set_looping(false);
        clock.advance(3000.0);
        assert_eq!((clock.timestep(), clock.is_playing()), (9, false));
        clock.play();
        assert_eq!((clock.timestep(), clock.is_playing()), (0, true));
        clock.set_speed(-2.0);
        clock.advance(4000.0);
        assert_eq!((clock.timestep(), clock.is_playing()), (0, false));
        clock.play();
        assert_eq!(clock.timestep(), 9);
    }

    #[test]
    fn steps_stop_the_clock() {
        let mut clock = playing();
        clock.step(-1);
        assert_eq!((clock.timestep(), clock.is_playing()), (9, false));
        clock.step(12);
        assert_eq!(clock.timestep(), 1);
        clock.set_looping(false);
        clock.step(i64::MIN);
        assert_eq!(clock.timestep(), 0);
        clock.step(100);
        assert_eq!(clock.timestep(), 9);
        clock.seek(1000);
        assert_eq!(clock.timestep(), 9);
    }

    #[test]
    fn a_scene_of_one_timestep_stands_still() {
        let mut clock = Clock::new(1, 0.0);
        assert_eq!(clock.frame_rate(), 30.0);
        clock.play();
        clock.advance(0.0);
        clock.advance(12_345.0);
        assert_eq!(clock.timestep(), 0);
        clock.step(-3);
        assert_eq!(clock.timestep(), 0);
    }
}
