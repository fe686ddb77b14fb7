//! A page on 127.0.0.1: nothing but the files that are given, to this machine alone.

use crate::{Error, Result};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::Duration;

/// Longest request that is read, bytes.
const REQUEST_MAX: u64 = 16 * 1024;
/// How long a client may take for a request.
const PATIENCE: Duration = Duration::from_secs(10);

/// Listens on 127.0.0.1.
#[derive(Debug)]
pub struct Server {
    listener: TcpListener,
    port: u16,
}

/// A file that is served.
pub(crate) struct File<'a> {
    path: &'a str,
    kind: &'static str,
    bytes: &'a [u8],
}

impl Server {
    /// Takes the port; 0 takes any free one.
    ///
    /// # Errors
    /// If another program has it, or the system refuses it.
    pub fn bind(port: u16) -> Result<Self> {
        let listener =
            TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(|source| match source.kind() {
                io::ErrorKind::AddrInUse => Error::PortTaken { port },
                _ => Error::Serve { port, source },
            })?;
        let port = listener.local_addr().map_err(|source| Error::Serve { port, source })?.port();
        Ok(Self { listener, port })
    }

    /// Where the page is.
    #[must_use]
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    /// Answers requests for the page at `/` and for its scene at `/scene.bin` until the process ends. A client that does not speak
    /// HTTP, or goes away, ends its own connection only.
    ///
    /// # Errors
    /// If the system takes the port away.
    pub fn run(&self, page: &str, scene: &[u8]) -> Result<()> {
        let files = [
            File { path: "/", kind: "text/html; charset=utf-8", bytes: page.as_bytes() },
            File { path: "/scene.bin", kind: "application/octet-stream", bytes: scene },
        ];
        std::thread::scope(|threads| {
            for stream in self.listener.incoming() {
                let stream = stream.map_err(|source| Error::Serve { port: self.port, source })?;
                let files = &files;
                threads.spawn(move || answer(stream, self.port, files));
            }
            Ok(())
        })
    }
}

/// Answers one request. What fails here is the client's connection, and nobody is left to be told.
fn answer(mut stream: TcpStream, port: u16, files: &[File]) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut lines = BufReader::new((&stream).take(REQUEST_MAX)).lines();
    let request = lines.next().transpose()?.unwrap_or_default();
    let mut host = None;
    for line in lines {
        let line = line?;
        if line.is_empty() {
            break;
        }
        if let Some((name, value)) = line.split_once(':')
            && name.eq_ignore_ascii_case("host")
        {
            host = Some(value.trim().to_owned());
        }
    }
    let (status, file) = respond(&request, host.as_deref(), port, files);
    let (kind, bytes) = file.map_or(("text/plain", status.as_bytes()), |file| (file.kind, file.bytes));
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n",
        bytes.len()
    );
    stream.write_all(head.as_bytes())?;
    if !request.starts_with("HEAD ") {
        stream.write_all(bytes)?;
    }
    stream.flush()
}

/// Status and file for a request. Another host's name in a request for this machine is a page of somebody else that tries to read it.
fn respond<'a>(
    request: &str,
    host: Option<&str>,
    port: u16,
    files: &'a [File<'a>],
) -> (&'static str, Option<&'a File<'a>>) {
    let ours = [format!("127.0.0.1:{port}"), format!("localhost:{port}")];
    if !host.is_some_and(|host| ours.iter().any(|name| name == host)) {
        return ("403 Forbidden", None);
    }
    let words: Vec<&str> = request.split(' ').collect();
    match words[..] {
        ["GET" | "HEAD", path, _] => match files.iter().find(|file| file.path == path) {
            Some(file) => ("200 OK", Some(file)),
            None => ("404 Not Found", None),
        },
        [_, _, version] if version.starts_with("HTTP/") => ("405 Method Not Allowed", None),
        _ => ("400 Bad Request", None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_files_are_served_and_only_to_this_machine() {
        let files = [File { path: "/", kind: "text/html", bytes: b"page" }];
        let status = |request, host| respond(request, host, 80, &files).0;
        let host = Some("127.0.0.1:80");
        assert_eq!(status("GET / HTTP/1.1", host), "200 OK");
        assert_eq!(status("GET / HTTP/1.1", Some("localhost:80")), "200 OK");
        assert_eq!(status("GET /../etc/passwd HTTP/1.1", host), "404 Not Found");
        assert_eq!(status("POST / HTTP/1.1", host), "405 Method Not Allowed");
        assert_eq!(status("", host), "400 Bad Request");
        assert_eq!(status("GET / HTTP/1.1", Some("evil.example:80")), "403 Forbidden");
        assert_eq!(status("GET / HTTP/1.1", None), "403 Forbidden");
    }

    #[test]
    fn a_taken_port_is_told_and_a_page_arrives() {
        let server = Server::bind(0).unwrap();
        let port = server.port;
        assert!(matches!(Server::bind(port), Err(Error::PortTaken { port: taken }) if taken == port));
        std::thread::spawn(move || server.run("the page", &[1, 2, 3]));
        let ask = |request: &str| {
            let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
            stream.write_all(request.as_bytes()).unwrap();
            let mut answer = Vec::new();
            stream.read_to_end(&mut answer).unwrap();
            answer
        };
        assert!(ask("nonsense\r\n\r\n").starts_with(b"HTTP/1.1 403"));
        let host = format!("Host: 127.0.0.1:{port}\r\n\r\n");
        assert!(ask(&format!("GET / HTTP/1.1\r\n{host}")).ends_with(b"\r\n\r\nthe page"));
        assert!(ask(&format!("GET /scene.bin HTTP/1.1\r\n{host}")).ends_with(&[b'\n', 1, 2, 3]));
        assert!(ask(&format!("HEAD / HTTP/1.1\r\n{host}")).ends_with(b"\r\n\r\n"));
    }
}
