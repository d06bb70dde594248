//! A server's answers to requests for a file. The requests themselves are in `web`.
//!
//! A player requests ranges. If the server sends the whole file instead, that download continues to its end, and all
//! ranges are taken from it.

use std::collections::VecDeque;
use std::ops::Range;
use std::task::Waker;

use crate::source::{Piece, SourceError};

/// Status and headers of an answer.
#[derive(Clone, Debug, Default)]
pub struct AnswerHead {
    /// HTTP status, such as 206.
    pub status: u16,
    /// Reason phrase of the status, such as `Partial Content`.
    pub status_text: String,
    /// Length of the whole file in bytes, where the headers tell it.
    pub length: Option<u64>,
    /// `Last-Modified`, else `ETag`. A different value means different bytes.
    pub version: Option<String>,
}

/// Collects the bytes and errors of answers until it is polled.
#[derive(Debug, Default)]
pub struct Inbox {
    /// Number of the current request. Bytes for an earlier request are dropped.
    request: u64,
    /// The part of the current range that is still to be polled, if a download of the whole file serves it.
    rest: Range<u64>,
    pieces: VecDeque<Result<Piece, SourceError>>,
    length: Option<u64>,
    version: Option<String>,
    whole: Option<Whole>,
    /// Woken by the next piece.
    waker: Option<Waker>,
}

/// A download of the whole file.
#[derive(Debug, Default)]
struct Whole {
    bytes: Vec<u8>,
    is_complete: bool,
}

impl Inbox {
    /// An inbox without a request.
    ///
    /// - `length`: of the whole file in bytes, where that is known before any answer
    pub fn new(length: Option<u64>) -> Self {
        Self { length, ..Self::default() }
    }

    /// Replaces the waker that the next piece wakes. A worker looks for pieces by itself.
    #[cfg(any(feature = "webgpu", test))]
    pub fn wake_by(&mut self, waker: Waker) {
        self.waker = Some(waker);
    }

    /// Length of the whole file in bytes, as soon as it is known.
    pub fn length(&self) -> Option<u64> {
        self.length
    }

    /// Begins a request for a range. The request before is dropped.
    ///
    /// - returns: the number of the request, which the caller sends; none if the whole file has arrived or is under way
    pub fn ask(&mut self, range: Range<u64>) -> Option<u64> {
        self.rest = range;
        self.whole.is_none().then(|| self.forget())
    }

    /// Drops the current request and what has arrived of it.
    ///
    /// - returns: the number of the next request
    pub fn forget(&mut self) -> u64 {
        self.pieces.clear();
        self.request += 1;
        self.request
    }

    /// Whether a request is the current one.
    pub fn is_current(&self, request: u64) -> bool {
        self.request == request
    }

    /// Takes the head of the answer to the current request.
    ///
    /// - `what`: address of the file, for messages
    /// - returns: whether bytes follow
    ///
    /// # Errors
    /// [`SourceError::Interrupted`] if the server reports a problem that may pass, [`SourceError::Refused`] if it
    /// answers with another status or if the file has changed since an earlier answer.
    pub fn begin(&mut self, what: &str, head: AnswerHead) -> Result<bool, SourceError> {
        let AnswerHead { status, status_text, length, version } = head;
        if ![200, 206, 416].contains(&status) {
            let (what, problem) = (what.to_owned(), format!("the server answers {status} {status_text}"));
            // Timeout, too many requests, or a server error: another request may succeed.
            let passes = matches!(status, 408 | 429 | 500..);
            return Err(if passes {
                SourceError::Interrupted { what, problem }
            } else {
                SourceError::Refused { what, problem }
            });
        }
        if differs(self.length, length) || differs(self.version.as_ref(), version.as_ref()) {
            let problem = "it has changed meanwhile; open it again".into();
            return Err(SourceError::Refused { what: what.into(), problem });
        }
        self.length = self.length.or(length);
        self.version = self.version.take().or(version);
        if status == 200 {
            self.whole = Some(Whole::default());
        }
        // Status 416 says that the range starts past the end of the file.
        Ok(status != 416)
    }

    /// Takes bytes of an answer.
    pub fn add(&mut self, request: u64, bytes: Vec<u8>) {
        if !self.is_current(request) || bytes.is_empty() {
            return;
        }
        match &mut self.whole {
            Some(whole) => whole.bytes.extend_from_slice(&bytes),
            None => self.pieces.push_back(Ok(Piece::Bytes(bytes))),
        }
        self.wake();
    }

    /// Takes the end of an answer, or the error that ended it.
    pub fn end(&mut self, request: u64, result: Result<(), SourceError>) {
        if !self.is_current(request) {
            return;
        }
        match (result, &mut self.whole) {
            (Ok(()), Some(whole)) => {
                whole.is_complete = true;
                self.length = Some(whole.bytes.len() as u64);
            }
            (Ok(()), None) => self.pieces.push_back(Ok(Piece::End)),
            (Err(error), _) => {
                // The rest of the whole file will not arrive, so ranges have to be requested again.
                self.whole = None;
                self.pieces.push_back(Err(error));
            }
        }
        self.wake();
    }

    /// As [`RangeSource::poll`](crate::RangeSource::poll).
    pub fn poll(&mut self) -> Result<Piece, SourceError> {
        if let Some(whole) = &self.whole {
            let end = self.rest.end.min(whole.bytes.len() as u64);
            if self.rest.start < end {
                let bytes = whole.bytes[self.rest.start as usize..end as usize].to_vec();
                self.rest.start = end;
                return Ok(Piece::Bytes(bytes));
            }
            if whole.is_complete || self.rest.is_empty() {
                return Ok(Piece::End);
            }
        }
        self.pieces.pop_front().unwrap_or(Ok(Piece::Waiting))
    }

    fn wake(&mut self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}

/// Whether both values are known and differ.
fn differs<T: PartialEq>(before: Option<T>, now: Option<T>) -> bool {
    before.zip(now).is_some_and(|(before, now)| before != now)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::task::Wake;

    use super::*;

    /// Counts how often it was woken.
    #[derive(Default)]
    struct Sleeper(AtomicUsize);

    impl Wake for Sleeper {
        fn wake(self: Arc<Self>) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    const WHAT: &str = "http://host/a.tcgs";

    fn head(status: u16) -> AnswerHead {
        AnswerHead { status, status_text: "why".into(), length: Some(10), version: Some("\"a\"".into()) }
    }

    fn broken() -> SourceError {
        SourceError::Interrupted { what: WHAT.into(), problem: "it broke".into() }
    }

    #[test]
    fn ranges_arrive_piece_by_piece() {
        let mut inbox = Inbox::new(None);
        let first = inbox.ask(0..4).unwrap();
        assert_eq!(inbox.poll(), Ok(Piece::Waiting));
        assert_eq!(inbox.begin(WHAT, head(206)), Ok(true));
        inbox.add(first, vec![1, 2]);
        let second = inbox.ask(2..12).unwrap();
        inbox.add(first, vec![3]);
        inbox.end(first, Err(broken()));
        assert_eq!((inbox.poll(), inbox.length()), (Ok(Piece::Waiting), Some(10)), "the first is forgotten");
        inbox.add(second, vec![3, 4]);
        inbox.end(second, Ok(()));
        assert_eq!(inbox.poll(), Ok(Piece::Bytes(vec![3, 4])));
        assert_eq!(inbox.poll(), Ok(Piece::End));
        assert!(inbox.ask(10..12).is_some());
        assert_eq!(inbox.begin(WHAT, head(416)), Ok(false));
    }

    #[test]
    fn who_waits_hears_of_the_next_piece_once() {
        for status in [200, 206] {
            let (mut inbox, sleeper) = (Inbox::new(None), Arc::new(Sleeper::default()));
            let request = inbox.ask(0..4).unwrap();
            assert_eq!(inbox.begin(WHAT, head(status)), Ok(true));
            inbox.wake_by(sleeper.clone().into());
            assert_eq!(sleeper.0.load(Ordering::Relaxed), 0);
            inbox.add(request, vec![1]);
            inbox.add(request, vec![2]);
            assert_eq!(sleeper.0.load(Ordering::Relaxed), 1);
            inbox.wake_by(sleeper.clone().into());
            inbox.end(request, Err(broken()));
            assert_eq!(sleeper.0.load(Ordering::Relaxed), 2);
        }
    }

    #[test]
    fn a_whole_file_serves_every_range() {
        let mut inbox = Inbox::new(None);
        let request = inbox.ask(0..2).unwrap();
        assert_eq!(inbox.begin(WHAT, head(200)), Ok(true));
        inbox.add(request, vec![0, 1, 2]);
        assert_eq!([inbox.poll(), inbox.poll()], [Ok(Piece::Bytes(vec![0, 1])), Ok(Piece::End)]);
        assert_eq!(inbox.ask(2..12), None);
        assert_eq!([inbox.poll(), inbox.poll()], [Ok(Piece::Bytes(vec![2])), Ok(Piece::Waiting)]);
        inbox.add(request, (3..10).collect());
        inbox.end(request, Ok(()));
        assert_eq!([inbox.poll(), inbox.poll()], [Ok(Piece::Bytes((3..10).collect())), Ok(Piece::End)]);
        assert_eq!(inbox.ask(0..1), None);
        assert_eq!(inbox.poll(), Ok(Piece::Bytes(vec![0])));
    }

    #[test]
    fn a_whole_file_that_breaks_off_is_asked_for_again() {
        let mut inbox = Inbox::new(None);
        let request = inbox.ask(0..10).unwrap();
        assert_eq!(inbox.begin(WHAT, head(200)), Ok(true));
        inbox.add(request, vec![0, 1, 2]);
        assert_eq!(inbox.poll(), Ok(Piece::Bytes(vec![0, 1, 2])));
        inbox.end(request, Err(broken()));
        assert_eq!(inbox.poll(), Err(broken()));
        let again = inbox.ask(3..10).expect("another request");
        assert_eq!(inbox.begin(WHAT, head(200)), Ok(true));
        inbox.add(again, (0..10).collect());
        inbox.end(again, Ok(()));
        assert_eq!([inbox.poll(), inbox.poll()], [Ok(Piece::Bytes((3..10).collect())), Ok(Piece::End)]);
    }

    #[test]
    fn servers_in_trouble_may_be_asked_again_and_others_not() {
        for (status, passes) in [(408, true), (429, true), (500, true), (503, true), (404, false), (403, false)] {
            let error = Inbox::new(None).begin(WHAT, head(status)).unwrap_err();
            assert!(error.to_string().ends_with(&format!("the server answers {status} why")), "{error}");
            assert_eq!(matches!(error, SourceError::Interrupted { .. }), passes, "{status}");
        }
    }

    #[test]
    fn a_file_that_changes_meanwhile_is_told() {
        let longer = AnswerHead { length: Some(11), ..head(206) };
        let other = AnswerHead { version: Some("\"b\"".into()), ..head(200) };
        let silent = AnswerHead { length: None, version: None, ..head(206) };
        for changed in [longer, other] {
            let mut inbox = Inbox::new(None);
            for same in [&silent, &head(206), &silent] {
                assert_eq!(inbox.begin(WHAT, same.clone()), Ok(true), "{same:?}");
            }
            let error = inbox.begin(WHAT, changed).unwrap_err();
            assert_eq!(error.to_string(), "http://host/a.tcgs cannot be read: it has changed meanwhile; open it again");
            assert!(matches!(error, SourceError::Refused { .. }), "asking again would not help");
        }
    }
}
