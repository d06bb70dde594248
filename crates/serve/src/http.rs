//! The part of HTTP/1.1 for serving files: heads of requests, and byte ranges.

use std::io::{self, BufRead, ErrorKind, Read};
use std::ops::Range;

/// Longest head of a request that is read; browsers send less than a kilobyte.
const MAX_HEAD_BYTES: u64 = 16 * 1024;

/// The head of a request.
#[derive(Debug, PartialEq)]
pub struct HttpRequest {
    /// HTTP method, such as `GET`.
    pub method: String,
    /// Path of the target, without the query.
    pub path: String,
    /// Names, in lower case, and values.
    headers: Vec<(String, String)>,
}

impl HttpRequest {
    /// Reads the next request of a connection; `None` at the end of the connection.
    ///
    /// # Errors
    /// `InvalidData` if the bytes are no request of HTTP/1.0 or 1.1, or if the request has a body, which file requests
    /// lack.
    pub fn read(connection: &mut impl BufRead) -> io::Result<Option<Self>> {
        let wrong = || io::Error::from(ErrorKind::InvalidData);
        let mut head = connection.take(MAX_HEAD_BYTES);
        let line = |head: &mut io::Take<_>| -> io::Result<Option<String>> {
            let mut line = String::new();
            BufRead::read_line(head, &mut line)?;
            Ok(line.strip_suffix("\r\n").map(str::to_owned))
        };
        let Some(first) = line(&mut head)? else { return Ok(None) };
        let mut words = first.split(' ');
        let (Some(method), Some(target), Some("HTTP/1.1" | "HTTP/1.0"), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(wrong());
        };
        let path = target.split('?').next().unwrap_or_default().to_owned();
        let mut request = Self { method: method.to_owned(), path, headers: Vec::new() };
        loop {
            let text = line(&mut head)?.ok_or_else(wrong)?;
            if text.is_empty() {
                break;
            }
            let (name, value) = text.split_once(':').ok_or_else(wrong)?;
            request.headers.push((name.to_ascii_lowercase(), value.trim().to_owned()));
        }
        let has_body =
            request.header("transfer-encoding").is_some() || request.header("content-length").is_some_and(|n| n != "0");
        if has_body { Err(wrong()) } else { Ok(Some(request)) }
    }

    /// The value of a header, if the request has it.
    ///
    /// - `name`: in lower case
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }
}

/// The part of a file that a request asks for.
#[derive(Debug, PartialEq)]
pub enum RequestedRange {
    /// The whole file.
    Whole,
    /// These bytes, within the file.
    Bytes(Range<u64>),
    /// Bytes past the end of the file.
    Beyond,
}

impl RequestedRange {
    /// Reads the header `Range`. A malformed header, or one with several ranges, counts as a request for the whole
    /// file, as RFC 9110 allows.
    ///
    /// - `header`: value of the header, if the request has it
    /// - `length`: length of the file, bytes
    pub fn of(header: Option<&str>, length: u64) -> Self {
        let ends = header.and_then(|value| value.strip_prefix("bytes=")).and_then(|range| range.split_once('-'));
        let Some((first, last)) = ends else { return Self::Whole };
        let number = |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse::<u64>().ok()).flatten();
        match (first, number(first), last, number(last)) {
            ("", _, _, Some(count)) if count > 0 && length > 0 => Self::Bytes(length.saturating_sub(count)..length),
            ("", _, _, Some(_)) => Self::Beyond,
            (_, Some(first), "", _) if first < length => Self::Bytes(first..length),
            (_, Some(first), _, Some(last)) if first < length && first <= last => {
                Self::Bytes(first..length.min(last.saturating_add(1)))
            }
            (_, Some(_), "", _) => Self::Beyond,
            (_, Some(first), _, Some(last)) if first <= last => Self::Beyond,
            _ => Self::Whole,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_read_one_after_the_other() {
        let mut bytes: &[u8] = b"GET /a?b=c HTTP/1.1\r\nHost: x\r\nRANGE:  bytes=0-1 \r\n\r\nHEAD / HTTP/1.0\r\n\r\n";
        let first = HttpRequest::read(&mut bytes).unwrap().unwrap();
        assert_eq!((first.method.as_str(), first.path.as_str()), ("GET", "/a"));
        assert_eq!((first.header("host"), first.header("range")), (Some("x"), Some("bytes=0-1")));
        assert_eq!(HttpRequest::read(&mut bytes).unwrap().unwrap().method, "HEAD");
        assert_eq!(HttpRequest::read(&mut bytes).unwrap(), None);
    }

    #[test]
    fn what_is_no_request_is_refused() {
        let endless = format!("GET / HTTP/1.1\r\na: {}\r\n\r\n", "b".repeat(MAX_HEAD_BYTES as usize));
        let cases = [
            "GET /\r\n\r\n",
            "GET / HTTP/2\r\n\r\n",
            "GET / / HTTP/1.1\r\n\r\n",
            "GET / HTTP/1.1\r\nnonsense\r\n\r\n",
            "GET / HTTP/1.1\r\nHost: x\r\n",
            "POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc",
            "POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n",
            &endless,
        ];
        for case in cases {
            let mut bytes = case.as_bytes();
            let kind = HttpRequest::read(&mut bytes).unwrap_err().kind();
            assert_eq!(kind, ErrorKind::InvalidData, "{case}");
        }
    }

    #[test]
    fn ranges_are_cut_to_the_file() {
        let of = |header: &str| RequestedRange::of(Some(header), 10);
        assert_eq!(RequestedRange::of(None, 10), RequestedRange::Whole);
        assert_eq!(of("bytes=0-0"), RequestedRange::Bytes(0..1));
        assert_eq!(of("bytes=3-"), RequestedRange::Bytes(3..10));
        assert_eq!(of("bytes=3-99"), RequestedRange::Bytes(3..10));
        assert_eq!(of("bytes=3-18446744073709551615"), RequestedRange::Bytes(3..10));
        assert_eq!(of("bytes=-4"), RequestedRange::Bytes(6..10));
        assert_eq!(of("bytes=-99"), RequestedRange::Bytes(0..10));
        for beyond in ["bytes=10-", "bytes=10-12", "bytes=-0"] {
            assert_eq!(of(beyond), RequestedRange::Beyond, "{beyond}");
        }
        assert_eq!(RequestedRange::of(Some("bytes=0-"), 0), RequestedRange::Beyond);
        for odd in ["bytes=", "bytes=-", "bytes=a-b", "bytes=5-2", "lines=0-1", "bytes=0-1,4-5", "bytes=+1-2"] {
            assert_eq!(of(odd), RequestedRange::Whole, "{odd}");
        }
    }
}
