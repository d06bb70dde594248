//! `tcgs train --view`: the player's page during a training.

use std::net::Ipv4Addr;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use tcgs_pipeline::{LiveFile, LiveRun, PipelineError};
use tcgs_serve::{NO_PAGE, PAGE, SceneSource, Server, Training, TrainingFile};

use crate::interrupt;
use crate::terminal::{note, say};

/// Time without a request after which a page counts as closed. Browsers throttle the timers of hidden pages to once a
/// minute.
const CLOSED: Duration = Duration::from_secs(90);
/// Interval of the check for Ctrl-C at the end.
const TURN: Duration = Duration::from_millis(200);

/// Parses the port of `ADDRESS`, which must be on this machine.
pub fn port(address: &str) -> Result<u16, String> {
    let expected = "expected 127.0.0.1:PORT: the training is shown to this machine alone";
    let port = match address.rsplit_once(':') {
        Some(("127.0.0.1" | "localhost", port)) => port,
        None if ["127.0.0.1", "localhost"].contains(&address) => "0",
        None => address,
        Some(_) => return Err(expected.into()),
    };
    port.parse().map_err(|_| expected.into())
}

/// A server that shows a training. It ends with this program.
pub struct View {
    site: Arc<Site>,
}

/// State behind the server's answers.
#[derive(Debug)]
struct Site {
    /// `None` before the training begins.
    live: Mutex<Option<Arc<LiveRun>>>,
    /// Time of the last request.
    asked: Mutex<Option<Instant>>,
}

impl View {
    /// Starts the server and prints its address.
    pub fn begin(port: u16) -> anyhow::Result<Self> {
        if PAGE.is_empty() {
            return Err(anyhow!(NO_PAGE));
        }
        let site = Arc::new(Site { live: Mutex::new(None), asked: Mutex::new(None) });
        let training: Arc<dyn Training> = Arc::clone(&site) as _;
        let server = Server::bind(port, SceneSource::Training(training), PAGE)
            .with_context(|| format!("serving at port {port} of {}", Ipv4Addr::LOCALHOST))?;
        say(&format!("watch at {}", server.address()?))?;
        let serve = move || server.run(|error| note(&format!("a connection failed: {error}")));
        thread::Builder::new().name("view".into()).spawn(serve).context("serving the page")?;
        Ok(Self { site })
    }

    /// Shows a run from this call on.
    pub fn show(&self, live: Arc<LiveRun>) {
        *self.site.live.lock().unwrap_or_else(PoisonError::into_inner) = Some(live);
    }

    /// Shows the whole run until no page asks for it any more, or until Ctrl-C.
    pub fn finish(&self) {
        let Some(live) = self.site.live() else { return };
        live.end();
        let is_watched = || {
            let asked = *self.site.asked.lock().unwrap_or_else(PoisonError::into_inner);
            asked.is_some_and(|asked| asked.elapsed() < CLOSED)
        };
        if is_watched() {
            note("the page shows the whole run; this ends when the page is closed, or by Ctrl-C");
        }
        while is_watched() && interrupt::asked().is_continue() {
            thread::sleep(TURN);
        }
    }
}

impl Site {
    fn live(&self) -> Option<Arc<LiveRun>> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Training for Site {
    fn answer(&self, path: &str, known: Option<&str>) -> Result<Option<TrainingFile>, String> {
        *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        let Some(live) = self.live() else { return Ok(None) };
        let file = |made: Result<Option<LiveFile>, PipelineError>| match made {
            Ok(file) => Ok(file.map(|LiveFile { tag, bytes }| TrainingFile { tag, bytes })),
            Err(error) => Err(error.to_string()),
        };
        match path {
            "/running.tcgs" => file(live.running(known)),
            "/finished.tcgs" => file(live.finished(known)),
            _ => Ok(Some(TrainingFile { tag: "state".into(), bytes: live.state().to_string().into_bytes().into() })),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_machine_is_an_address() {
        for (address, expected) in
            [("127.0.0.1:80", 80), ("localhost:0", 0), ("8000", 8000), ("127.0.0.1", 0), ("localhost", 0)]
        {
            assert_eq!(port(address), Ok(expected), "{address}");
        }
        for address in ["0.0.0.0:80", "192.168.0.2:80", "[::]:80", "example.org", "127.0.0.1:x", ":80", "", "70000"] {
            assert!(port(address).unwrap_err().contains("this machine alone"), "{address}");
        }
    }
}
