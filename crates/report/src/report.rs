//! The HTML report: figures, pictures, time, Gaussians, and the recipe, in one self-contained file.

use crate::Result;
use evaluate::{Figures, Outcome, Target};
use report_parts::colour::{DEPTH, ERROR};
use report_parts::page::{bars, document, escape, figure, legend, table, tile};
use report_parts::{DepthScale, ERROR_GAIN, Picture, Table, count, decibel, number};
use scene_windows::Window;
use sparsesplat::ViewGeometry;
use std::fmt::Write;

/// How much of a window a page shows: the file's size is made of pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureLimits {
    /// Targets shown; the first ones.
    pub targets: usize,
    /// Greatest width of a target's pictures, pixels.
    pub target_width: u32,
    /// Greatest width of an input's pictures, pixels.
    pub input_width: u32,
}

impl PictureLimits {
    /// Everything, for the report of one window.
    pub const ONE_WINDOW: Self = Self { targets: 12, target_width: 640, input_width: 480 };

    /// What lets a page of `windows` windows stay below some 20 MB.
    #[must_use]
    pub fn for_windows(windows: usize) -> Self {
        match windows {
            0..=1 => Self::ONE_WINDOW,
            2..=8 => Self { targets: 4, target_width: 480, input_width: 320 },
            9..=24 => Self { targets: 2, target_width: 480, input_width: 240 },
            _ => Self { targets: 1, target_width: 320, input_width: 160 },
        }
    }
}

/// A page in the making. Windows are drawn as they come, so that nobody has to keep their pictures.
#[derive(Debug, Clone)]
pub struct Report {
    title: String,
    lead: String,
    head: String,
    links: Vec<(String, String)>,
    sections: String,
}

impl Report {
    /// A page with a title and a sentence below it.
    #[must_use]
    pub fn new(title: &str, lead: &str) -> Self {
        let (title, lead) = (title.to_owned(), lead.to_owned());
        Self { title, lead, head: String::new(), links: Vec::new(), sections: String::new() }
    }

    /// The figures that matter most, above everything else.
    pub fn headline(&mut self, figures: &Figures, peak_rss_bytes: Option<u64>) {
        let mut tiles = Vec::new();
        if figures.psnr_held_out.is_finite() {
            let gain = figures.psnr_held_out - figures.psnr_nearest_view;
            tiles.push((format!("{} dB", decibel(figures.psnr_held_out)), "PSNR of views never seen"));
            tiles.push((number(figures.ssim_held_out, 3), "SSIM of views never seen"));
            tiles.push((format!("{gain:+.2} dB"), "above the nearest photograph"));
            let refined = figures.psnr_held_out - figures.psnr_held_out_feed_forward;
            if refined.is_finite() {
                tiles.push((format!("{refined:+.2} dB"), "of it by refinement"));
            }
        }
        tiles.push((count(figures.gaussians), "Gaussians"));
        tiles.push((
            format!("{} s", number(figures.seconds.to_gaussians(), 2)),
            "from photographs to Gaussians",
        ));
        if let Some(bytes) = peak_rss_bytes {
            tiles.push((format!("{:.2} GB", bytes as f64 / 1e9), "peak memory"));
        }
        self.head.push_str("<div class=\"tiles\">\n");
        self.head.extend(tiles.iter().map(|(value, meaning)| tile(value, meaning)));
        self.head.push_str("</div>\n");
    }

    /// A table, above the windows.
    pub fn table(&mut self, rows: &Table, caption: &str) {
        self.head.push_str(&table(rows, caption));
    }

    /// A sentence that must not be overlooked, above the windows.
    pub fn warning(&mut self, text: &str) {
        let _ = writeln!(self.head, "<p class=\"warning\">{}</p>", escape(text));
    }

    /// A link to a page beside the report that shows the scene of a window live, with the size of that page.
    pub fn viewer(&mut self, window: &str, link: &str, size: &str) {
        let _ = writeln!(
            self.head,
            "<p><a href=\"{}\">Look at {} in the browser</a> <span class=\"soft\">({}, needs WebGPU)</span></p>",
            escape(link),
            escape(window),
            escape(size)
        );
    }

    /// A section with the pictures of one window.
    ///
    /// # Errors
    /// If a picture cannot be encoded.
    ///
    /// # Panics
    /// If the outcome is not this window's.
    pub fn window(&mut self, window: &Window, outcome: &Outcome, limits: PictureLimits) -> Result<()> {
        assert_eq!(outcome.renderings.len(), window.targets.len(), "a rendering per target");
        assert_eq!(outcome.prediction.geometry.len(), window.context.len(), "depth for each context view");
        let confident: Vec<Vec<f32>> = outcome.prediction.geometry.iter().map(confident_depth).collect();
        let scale = DepthScale::of(confident.iter().map(Vec::as_slice));
        let anchor = format!("w{}", self.links.len());
        let mut html = format!("<section><h2 id=\"{anchor}\">{}</h2>\n", escape(&window.name));
        let _ = writeln!(html, "<p class=\"soft\">{}</p>", escape(&in_words(window, outcome)));
        if !window.targets.is_empty() {
            html.push_str(&targets(window, outcome, scale, limits)?);
        }
        html.push_str(&inputs(window, outcome, scale, limits)?);
        html.push_str("<div class=\"halves\"><div>\n");
        html.push_str(&time(outcome));
        html.push_str("</div><div>\n");
        html.push_str(&gaussians(window, outcome));
        html.push_str("</div></div>\n</section>\n");
        self.sections.push_str(&html);
        self.links.push((anchor, window.name.clone()));
        Ok(())
    }

    /// The whole page; `recipe` is JSON.
    #[must_use]
    pub fn to_html(&self, recipe: &str) -> String {
        let mut links = String::new();
        if self.links.len() > 1 {
            for (anchor, name) in &self.links {
                let _ = write!(links, "<a href=\"#{anchor}\">{}</a> ", escape(name));
            }
        }
        let lead = format!("<p class=\"soft\">{}</p>\n", escape(&self.lead));
        let body = format!("{lead}{}<nav>{links}</nav>\n{}", self.head, self.sections);
        document(&self.title, &body, recipe)
    }
}

/// Depths that are measured, 0 where they are filled in: a scale of depth must not follow guesses.
fn confident_depth(geometry: &ViewGeometry) -> Vec<f32> {
    let pixels = geometry.depth.data().iter().enumerate();
    pixels.map(|(i, &depth)| if geometry.is_confirmed(i) { depth } else { 0.0 }).collect()
}

/// The figures of a window in a sentence.
fn in_words(window: &Window, outcome: &Outcome) -> String {
    let figures = &outcome.figures.figures;
    let mut text =
        format!("{} photographs in, {} Gaussians out", window.context.len(), count(figures.gaussians));
    if !window.targets.is_empty() {
        let _ = write!(
            text,
            "; {} views held out: {} dB, SSIM {} (nearest photograph shown as it is: {} dB)",
            window.targets.len(),
            decibel(figures.psnr_held_out),
            number(figures.ssim_held_out, 3),
            decibel(figures.psnr_nearest_view)
        );
    }
    if let Some(refinement) = &outcome.figures.refinement {
        let (steps, seconds) = (refinement.report.steps.len(), refinement.report.seconds);
        let corrected = if refinement.corrected.is_some() { " and corrected" } else { "" };
        let _ = write!(text, "; refined in {steps} steps{corrected}, {}", duration(seconds));
        if figures.psnr_held_out_feed_forward.is_finite() {
            let _ = write!(text, ", from {} dB", decibel(figures.psnr_held_out_feed_forward));
        }
    }
    text
}

/// Rows of target, rendering, error, depth.
fn targets(window: &Window, outcome: &Outcome, scale: DepthScale, limits: PictureLimits) -> Result<String> {
    let shown = window.targets.len().min(limits.targets);
    let mut html = String::from("<h3>Views it never saw</h3>\n<div class=\"legend\">");
    html.push_str(&legend(&DEPTH, "depth", &length(scale.farthest()), &length(scale.nearest())));
    html.push_str(&legend(&ERROR, "error", "0", &format!("{} of the range or more", 1.0 / ERROR_GAIN)));
    html.push_str("<span>A click enlarges a picture.</span></div>\n");
    let rows = window.targets.iter().zip(&outcome.renderings).zip(&outcome.figures.per_target);
    for ((view, rendering), target) in rows.take(shown) {
        let Target { name, psnr, ssim, lpips, error_in_worst_tenth, .. } = target;
        let Target { psnr_feed_forward, nearest_view, psnr_nearest_view, .. } = target;
        let before = psnr_feed_forward
            .map_or(String::new(), |before| format!("; before refinement {} dB", decibel(before)));
        let lpips = lpips.map_or(String::new(), |lpips| format!(", LPIPS {}", number(lpips, 3)));
        let _ = write!(
            html,
            "<p class=\"target\">{} &nbsp; {} dB, SSIM {}{lpips}{before} <span>({:.0} % of the squared error in a tenth of the pixels; nearest photograph, {}, shown as it is: {} dB)</span></p>\n\
             <div class=\"row four\">\n",
            escape(name),
            decibel(*psnr),
            number(*ssim, 3),
            100.0 * error_in_worst_tenth,
            escape(nearest_view),
            decibel(*psnr_nearest_view)
        );
        let (width, height) = (view.image().width(), view.image().height());
        let pictures = [
            (Picture::of_image(view.image()), "photograph"),
            (Picture::of_image(&rendering.image), "rendering"),
            (Picture::of_error(view.image(), &rendering.image), "error"),
            (Picture::of_depth(width, height, &rendering.depth, scale), "rendered depth"),
        ];
        for (picture, what) in pictures {
            html.push_str(&figure(
                &picture.at_most(limits.target_width),
                &format!("{what} of {name}"),
                what,
            )?);
        }
        html.push_str("</div>\n");
    }
    if shown < window.targets.len() {
        let _ = writeln!(
            html,
            "<p class=\"soft\">{} more targets are measured and not shown.</p>",
            window.targets.len() - shown
        );
    }
    Ok(html)
}

/// Photograph, depth and confidence of each context view.
fn inputs(window: &Window, outcome: &Outcome, scale: DepthScale, limits: PictureLimits) -> Result<String> {
    let mut html = String::from("<h3>Input views</h3>\n<div class=\"row inputs\">\n");
    for (view, geometry) in window.context.iter().zip(&outcome.prediction.geometry) {
        let (width, height) = (view.image().width(), view.image().height());
        let pictures = [
            (Picture::of_image(view.image()), view.name()),
            (Picture::of_depth(width, height, geometry.depth.data(), scale), "estimated depth"),
            (Picture::of_mask(width, height, &geometry.confidence), "confidence"),
        ];
        html.push_str("<div class=\"three\">\n");
        for (picture, what) in pictures {
            let description = format!("{what}, input {}", view.name());
            html.push_str(&figure(&picture.at_most(limits.input_width), &description, what)?);
        }
        html.push_str("</div>\n");
    }
    html.push_str("</div>\n");
    Ok(html)
}

/// Bars of time per stage; stages that did not run are left out.
fn time(outcome: &Outcome) -> String {
    let seconds = &outcome.figures.figures.seconds;
    let entries: Vec<_> = seconds
        .by_name()
        .filter(|(_, seconds)| *seconds > 0.0)
        .map(|(name, seconds)| (name.to_owned(), seconds, duration(seconds)))
        .collect();
    let total = duration(seconds.total);
    format!("<h3>Where the time went: {total} in all</h3>\n{}", bars(&entries, "wall time per stage"))
}

/// Gaussians per view and of the shell, with exposure where it was touched.
fn gaussians(window: &Window, outcome: &Outcome) -> String {
    let counts = &outcome.figures.counts;
    let exposed = outcome.figures.exposure.iter().any(|e| (e.gain, e.bias) != (1.0, 0.0));
    let share = |n: usize| format!("{:.1} %", 100.0 * n as f64 / counts.total.max(1) as f64);
    let mut rows = Table::new(
        if exposed {
            &["view", "Gaussians", "share", "gain", "bias"]
        } else {
            &["view", "Gaussians", "share"]
        },
        1,
    );
    let mut push = |name: &str, n: usize, exposure: Option<(f32, f32)>| {
        let mut row = vec![name.to_owned(), count(n as f64), share(n)];
        if exposed {
            row.extend(exposure.map_or([String::new(), String::new()], |(gain, bias)| {
                [format!("{gain:.3}"), format!("{bias:+.3}")]
            }));
        }
        rows.push(row);
    };
    for (i, view) in window.context.iter().enumerate() {
        let exposure = outcome.figures.exposure.get(i).map(|e| (e.gain, e.bias));
        push(view.name(), counts.per_view.get(i).copied().unwrap_or(0), exposure);
    }
    push("far shell", counts.shell, None);
    push("all", counts.total, None);
    format!("<h3>Where the Gaussians are</h3>\n{}", table(&rows, ""))
}

/// Seconds as a person reads them.
fn duration(seconds: f64) -> String {
    if seconds < 0.1 { format!("{:.1} ms", seconds * 1e3) } else { format!("{seconds:.2} s") }
}

/// A length in scene units with three digits.
fn length(units: f32) -> String {
    if !units.is_finite() {
        return "infinity".to_owned();
    }
    let digits = (2 - units.abs().max(1e-6).log10().floor() as i32).clamp(0, 6) as usize;
    format!("{units:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_times_have_three_digits() {
        assert_eq!([0.012_34, 1.234_5, 12.345, 1234.5].map(length), ["0.0123", "1.23", "12.3", "1234"]);
        assert_eq!(length(f32::INFINITY), "infinity");
        assert_eq!([0.0123, 1.234].map(duration), ["12.3 ms", "1.23 s"]);
    }
}
