//! Chromium without a window, through the DevTools protocol on a pair of pipes.

use serde_json::{Value, json};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// How long an answer of the browser may take.
const PATIENCE: Duration = Duration::from_secs(120);

/// What the browser runs without a graphics card.
const SOFTWARE: [&str; 2] = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader"];

/// A browser with one page.
pub(crate) struct Browser {
    child: Child,
    commands: File,
    answers: Receiver<Value>,
    session: String,
    last: u64,
    /// What pages wrote to the console as warnings and errors, exceptions, and addresses that they fetched.
    pub(crate) complaints: Vec<String>,
    /// Addresses that were asked for.
    pub(crate) requests: Vec<String>,
}

impl Browser {
    /// Starts the browser with a window of this size; its files go into `folder`.
    pub(crate) fn start(program: &Path, folder: &Path, webgpu: bool, size: (u32, u32)) -> io::Result<Self> {
        // A shell opens the pipes as descriptors 3 and 4, where the browser looks for them.
        let [commands, answers] = ["commands", "answers"].map(|name| folder.join(name));
        for pipe in [&commands, &answers] {
            let _ = std::fs::remove_file(pipe);
            if !Command::new("mkfifo").arg(pipe).status()?.success() {
                return Err(io::Error::other("mkfifo failed"));
            }
        }
        let mut start = Command::new("sh");
        start.args(["-c", "exec \"$0\" \"$@\" 3<\"$COMMANDS\" 4>\"$ANSWERS\""]).arg(program);
        // Containers give no sandbox; the pages are our own.
        start.args([
            "--headless=new",
            "--no-sandbox",
            "--hide-scrollbars",
            "--no-first-run",
            "--remote-debugging-pipe",
        ]);
        start.arg(format!("--window-size={},{}", size.0, size.1));
        start.arg(format!("--user-data-dir={}", folder.join("profile").display()));
        if webgpu {
            start.args(SOFTWARE);
        } else {
            start.arg("--disable-features=WebGPU").arg("--disable-gpu");
        }
        let log = File::create(folder.join("browser.log"))?;
        let child = start
            .env("COMMANDS", &commands)
            .env("ANSWERS", &answers)
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()?;
        let commands = File::options().write(true).open(&commands)?;
        let mut reader = BufReader::new(File::open(&answers)?);
        let (send, answers) = channel();
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            while reader.read_until(0, &mut bytes).is_ok_and(|n| n > 0) {
                bytes.pop();
                let Ok(value) = serde_json::from_slice(&bytes) else { break };
                if send.send(value).is_err() {
                    break;
                }
                bytes.clear();
            }
        });
        let mut browser = Self {
            child,
            commands,
            answers,
            session: String::new(),
            last: 0,
            complaints: Vec::new(),
            requests: Vec::new(),
        };
        let target = browser.call("Target.createTarget", json!({"url": "about:blank"}))?;
        let attached = browser
            .call("Target.attachToTarget", json!({"targetId": target["targetId"], "flatten": true}))?;
        browser.session = attached["sessionId"].as_str().unwrap_or_default().to_owned();
        for domain in ["Runtime", "Page", "Log", "Network", "DOM"] {
            browser.call(&format!("{domain}.enable"), json!({}))?;
        }
        let metrics = json!({"width": size.0, "height": size.1, "deviceScaleFactor": 1, "mobile": false});
        browser.call("Emulation.setDeviceMetricsOverride", metrics)?;
        Ok(browser)
    }

    /// Calls a method, and waits for its result.
    #[expect(clippy::needless_pass_by_value, reason = "callers make the value for the call")]
    pub(crate) fn call(&mut self, method: &str, params: Value) -> io::Result<Value> {
        self.last += 1;
        let mut message = json!({"id": self.last, "method": method, "params": params});
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        let mut bytes = serde_json::to_vec(&message)?;
        bytes.push(0);
        self.commands.write_all(&bytes)?;
        let deadline = Instant::now() + PATIENCE;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let answer = self.answers.recv_timeout(left).map_err(|error| match error {
                RecvTimeoutError::Timeout => io::Error::other(format!("{method}: no answer")),
                RecvTimeoutError::Disconnected => io::Error::other("the browser ended"),
            })?;
            if answer["id"] == json!(self.last) {
                if let Some(error) = answer.get("error") {
                    return Err(io::Error::other(format!("{method}: {error}")));
                }
                return Ok(answer["result"].clone());
            }
            self.event(&answer);
        }
    }

    fn event(&mut self, event: &Value) {
        let params = &event["params"];
        match event["method"].as_str() {
            Some("Runtime.consoleAPICalled") => self.complaints.push(format!("console: {}", params["args"])),
            Some("Runtime.exceptionThrown") => {
                self.complaints.push(format!("exception: {}", params["exceptionDetails"]));
            }
            Some("Log.entryAdded") => self.complaints.push(format!("log: {}", params["entry"])),
            Some("Network.requestWillBeSent") => {
                self.requests.extend(params["request"]["url"].as_str().map(str::to_owned));
            }
            _ => {}
        }
    }

    /// The value of an expression, awaited if it is a promise.
    pub(crate) fn evaluate(&mut self, expression: &str) -> io::Result<Value> {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let result = self.call("Runtime.evaluate", params)?;
        match result.get("exceptionDetails") {
            Some(details) => Err(io::Error::other(format!("{expression}: {details}"))),
            None => Ok(result["result"]["value"].clone()),
        }
    }

    /// Waits until an expression is true.
    pub(crate) fn wait_for(&mut self, expression: &str) -> io::Result<()> {
        let deadline = Instant::now() + PATIENCE;
        while self.evaluate(expression)? != json!(true) {
            if Instant::now() > deadline {
                let says = self.evaluate("document.body.innerText")?;
                return Err(io::Error::other(format!(
                    "{expression} does not come true; the page says {says}"
                )));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    /// Opens an address.
    pub(crate) fn open(&mut self, address: &str) -> io::Result<()> {
        self.requests.clear();
        self.call("Page.navigate", json!({"url": address}))?;
        self.wait_for("document.readyState === 'complete'")
    }

    /// Writes what the page looks like as PNG.
    pub(crate) fn screenshot(&mut self, path: &Path) -> io::Result<()> {
        use base64::Engine;
        let shot = self.call("Page.captureScreenshot", json!({"format": "png"}))?;
        let bytes = base64::engine::general_purpose::STANDARD
            .decode(shot["data"].as_str().unwrap_or_default())
            .map_err(io::Error::other)?;
        std::fs::write(path, bytes)
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.call("Browser.close", json!({}));
        let deadline = Instant::now() + Duration::from_secs(5);
        while self.child.try_wait().is_ok_and(|status| status.is_none()) {
            if Instant::now() > deadline {
                let _ = self.child.kill();
                let _ = self.child.wait();
                break;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
