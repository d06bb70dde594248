//! The state in two memories, the host's and a device's, with a record of the newest one.

use crate::state::State;

/// Location of the newest state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Newest {
    /// The host has changed it; the device has an older one or none.
    Host,
    /// Both memories hold the same.
    Both,
    /// The device has gone on since the host read it.
    Device,
}

/// The host's copy of a state that a device computes with.
#[derive(Debug)]
pub(crate) struct Mirror {
    state: State,
    newest: Newest,
    version: u64,
}

impl Mirror {
    /// A state that the device does not have yet.
    pub fn new(state: State) -> Self {
        Self { state, newest: Newest::Host, version: 0 }
    }

    /// The host's copy. Shape, quantizers' groups, past and counts of updates are the newest; values that iterations
    /// change may be older than the device's.
    pub fn host(&self) -> &State {
        &self.state
    }

    /// The host's copy, for data that only the host keeps: counts of updates.
    pub fn host_mut(&mut self) -> &mut State {
        &mut self.state
    }

    /// A number that changes whenever the newest state may have changed.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Uploads the host's changes, if any.
    ///
    /// # Errors
    /// Those of `write`; the changes then remain to be uploaded.
    pub fn upload<E>(&mut self, write: impl FnOnce(&State) -> Result<(), E>) -> Result<(), E> {
        if self.newest == Newest::Host {
            write(&self.state)?;
            self.newest = Newest::Both;
        }
        Ok(())
    }

    /// Records that the device computes an iteration.
    ///
    /// # Panics
    /// If the host's changes were not uploaded: the device would go on from an older state.
    pub fn advance(&mut self) {
        assert!(self.newest != Newest::Host, "an iteration on a state that was not uploaded");
        (self.newest, self.version) = (Newest::Device, self.version + 1);
    }

    /// Downloads the device's state, if it has gone on.
    ///
    /// # Errors
    /// Those of `read`; the device's state then remains to be downloaded.
    pub fn download<E>(&mut self, read: impl FnOnce(&mut State) -> Result<(), E>) -> Result<&State, E> {
        if self.newest == Newest::Device {
            read(&mut self.state)?;
            self.newest = Newest::Both;
        }
        Ok(&self.state)
    }

    /// The host's copy, for changes.
    ///
    /// # Panics
    /// If the device's state was not downloaded: the change would undo iterations.
    pub fn change(&mut self) -> &mut State {
        assert!(self.newest != Newest::Device, "a change of a state that was not downloaded");
        (self.newest, self.version) = (Newest::Host, self.version + 1);
        &mut self.state
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::Gaussians;

    use super::*;
    use crate::parameters::Parameters;

    fn mirror() -> Mirror {
        Mirror::new(State::new(Parameters {
            gaussians: Gaussians::zeros(1),
            mask_logits: vec![0.0],
            foreground: vec![true],
            camera_gains: Vec::new(),
            camera_offsets: Vec::new(),
        }))
    }

    fn count(ways: &mut usize) -> Result<(), &'static str> {
        *ways += 1;
        Ok(())
    }

    #[test]
    fn each_way_is_gone_once() {
        let mut mirror = mirror();
        let (mut uploads, mut downloads) = (0, 0);
        for _ in 0..2 {
            mirror.upload(|_| count(&mut uploads)).unwrap();
        }
        mirror.advance();
        mirror.advance();
        for _ in 0..2 {
            mirror.download(|_| count(&mut downloads)).unwrap();
        }
        let version = mirror.version();
        mirror.change();
        assert_ne!(mirror.version(), version);
        // A failed upload is repeated.
        assert!(mirror.upload(|_| Err("no memory")).is_err());
        mirror.upload(|_| count(&mut uploads)).unwrap();
        assert_eq!((uploads, downloads), (2, 1));
    }

    #[test]
    #[should_panic(expected = "not downloaded")]
    fn a_change_does_not_undo_iterations() {
        let mut mirror = mirror();
        mirror.upload(|_| count(&mut 0)).unwrap();
        mirror.advance();
        mirror.change();
    }
}
