//! Pieces of a self-contained page: text, pictures as data URIs, tables, bars.

use crate::picture::Picture;
use crate::table::Table;
use crate::{Result, colour};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fmt::Write;

/// JPEG quality of the pictures of a page.
const QUALITY: u8 = 90;

/// Text as it may stand in HTML, attributes included.
pub fn escape(text: &str) -> String {
    html_escape::encode_double_quoted_attribute(text).into_owned()
}

/// A page with a title and a style sheet; `body` is HTML.
#[must_use]
pub fn shell(title: &str, style: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}</title>\n<style>\n{style}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        escape(title)
    )
}

/// What the `src` of an `img` is for a JPEG within the page.
#[must_use]
pub fn jpeg_source(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg))
}

/// A whole page of a report, with the recipe at its end; `body` is HTML, `recipe` is JSON.
pub fn document(title: &str, body: &str, recipe: &str) -> String {
    let body = format!(
        "<h1>{}</h1>\n{body}<details><summary>How this was made</summary><pre>{}</pre></details>\n",
        escape(title),
        escape(recipe)
    );
    shell(title, include_str!("report.css"), &body)
}

/// A picture with its caption; a click shows it as large as the window. `description` is for those who cannot see it.
///
/// # Errors
/// If the picture is too large for JPEG.
pub fn figure(picture: &Picture, description: &str, caption: &str) -> Result<String> {
    let source = jpeg_source(&picture.to_jpeg(QUALITY)?);
    let (width, height) = picture.size();
    Ok(format!(
        "<figure><label><input type=\"checkbox\" aria-label=\"enlarge\"><img width=\"{width}\" height=\"{height}\" \
         alt=\"{}\" src=\"{source}\"></label><figcaption>{}</figcaption></figure>\n",
        escape(description),
        escape(caption)
    ))
}

/// One figure of the headline: value, and what it is.
pub fn tile(value: &str, meaning: &str) -> String {
    format!("<div class=\"tile\"><b>{}</b><span>{}</span></div>\n", escape(value), escape(meaning))
}

/// A table; rows whose first cell begins with `mean` stand out.
pub fn table(table: &Table, caption: &str) -> String {
    let mut html = format!("<div class=\"scroll\"><table><caption>{}</caption>\n<tr>", escape(caption));
    for cell in table.head() {
        let _ = write!(html, "<th>{}</th>", escape(cell));
    }
    html.push_str("</tr>\n");
    for row in table.rows() {
        html.push_str(if row[0].starts_with("mean") { "<tr class=\"mean\">" } else { "<tr>" });
        for cell in row {
            let _ = write!(html, "<td>{}</td>", escape(cell));
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</table></div>\n");
    html
}

/// Horizontal bars, one per entry: name, value, and the text behind the bar.
pub fn bars(entries: &[(String, f64, String)], description: &str) -> String {
    const ROW: usize = 24;
    const NAME: f64 = 110.0;
    const BAR: f64 = 290.0;
    let largest = entries.iter().map(|(_, value, _)| *value).fold(f64::MIN_POSITIVE, f64::max);
    let height = ROW * entries.len();
    let mut svg = format!(
        "<svg viewBox=\"0 0 480 {height}\" width=\"480\" height=\"{height}\" role=\"img\" aria-label=\"{}\">\n",
        escape(description)
    );
    for (i, (name, value, text)) in entries.iter().enumerate() {
        let (top, middle) = (i * ROW + 5, i * ROW + 17);
        let length = (BAR * value / largest).max(1.0);
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{middle}\" text-anchor=\"end\">{}</text>\
             <rect class=\"track\" x=\"{NAME}\" y=\"{top}\" width=\"{BAR}\" height=\"14\" rx=\"3\"/>\
             <rect class=\"bar\" x=\"{NAME}\" y=\"{top}\" width=\"{length:.1}\" height=\"14\" rx=\"3\"/>\
             <text x=\"{}\" y=\"{middle}\">{}</text>",
            NAME - 8.0,
            escape(name),
            NAME + BAR + 8.0,
            escape(text)
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// A ramp of colours with what its ends mean.
pub fn legend(ramp: &colour::Ramp, name: &str, low: &str, high: &str) -> String {
    let stops: Vec<String> = (0..=8).map(|i| colour::hex(ramp[i * 255 / 8])).collect();
    format!(
        "<span>{}: {}<i class=\"ramp\" style=\"background:linear-gradient(90deg,{})\"></i>{}</span>\n",
        escape(name),
        escape(low),
        stops.join(","),
        escape(high)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_the_page() {
        assert_eq!(escape("<b>\"x\" & y</b>"), "&lt;b&gt;&quot;x&quot; &amp; y&lt;/b&gt;");
        let mut rows = Table::new(&["<head>"], 1);
        rows.push(vec!["<cell>".into()]);
        let html = table(&rows, "<note>");
        assert!(["<cell>", "<head>", "<note>"].iter().all(|tag| !html.contains(tag)), "{html}");
        assert!(tile("<v>", "<m>").contains("&lt;v&gt;"));
    }

    #[test]
    fn bars_are_as_long_as_their_values_and_zero_is_seen() {
        let entry = |value: f64| ("n".to_owned(), value, String::new());
        let svg = bars(&[entry(2.0), entry(1.0), entry(0.0)], "");
        let lengths: Vec<&str> = svg
            .split("class=\"bar\"")
            .skip(1)
            .map(|part| part.split("width=\"").nth(1).unwrap().split('"').next().unwrap())
            .collect();
        assert_eq!(lengths, ["290.0", "145.0", "1.0"]);
        assert!(bars(&[entry(0.0)], "").contains("width=\"1.0\""));
    }
}
