//! Tables of figures: aligned text for a terminal, Markdown for documents.

/// A table of text: a head, rows, and how many columns on the left are names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
    names: usize,
}

impl Table {
    /// A table without rows, whose first `names` columns are set to the left (the others to the right).
    #[must_use]
    pub fn new(head: &[&str], names: usize) -> Self {
        Self { head: head.iter().map(|&cell| cell.to_owned()).collect(), rows: Vec::new(), names }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// If it has not one cell per column.
    pub fn push(&mut self, row: Vec<String>) {
        assert_eq!(row.len(), self.head.len(), "cells of a row");
        self.rows.push(row);
    }

    /// Head of each column.
    #[must_use]
    pub fn head(&self) -> &[String] {
        &self.head
    }

    /// The rows.
    #[must_use]
    pub fn rows(&self) -> &[Vec<String>] {
        &self.rows
    }

    fn widths(&self) -> Vec<usize> {
        let width = |column: usize| {
            let cells = std::iter::once(&self.head).chain(&self.rows);
            cells.map(|row| row[column].chars().count()).max().unwrap_or(0)
        };
        (0..self.head.len()).map(width).collect()
    }

    fn line(&self, row: &[String], widths: &[usize], separator: &str) -> String {
        let cell = |(column, (text, &width)): (usize, (&String, &usize))| {
            if column < self.names { format!("{text:<width$}") } else { format!("{text:>width$}") }
        };
        let cells: Vec<String> = row.iter().zip(widths).enumerate().map(cell).collect();
        cells.join(separator)
    }

    /// Aligned columns, one line per row, head first.
    #[must_use]
    pub fn to_text(&self) -> String {
        let widths = self.widths();
        let lines = std::iter::once(&self.head).chain(&self.rows);
        lines.map(|row| self.line(row, &widths, "  ").trim_end().to_owned() + "\n").collect()
    }

    /// A Markdown table.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let widths = self.widths();
        let mark = |(column, &width): (usize, &usize)| {
            let dashes = "-".repeat(width.max(2) - 1);
            if column < self.names { format!("{dashes}-") } else { format!("{dashes}:") }
        };
        let marks: Vec<String> = widths.iter().enumerate().map(mark).collect();
        let widths: Vec<usize> = widths.iter().map(|&width| width.max(2)).collect();
        let mut text = format!("| {} |\n| {} |\n", self.line(&self.head, &widths, " | "), marks.join(" | "));
        for row in &self.rows {
            text += &format!("| {} |\n", self.line(row, &widths, " | "));
        }
        text
    }
}

/// The column of LPIPS: figures of different networks say nothing about each other.
#[must_use]
pub fn lpips_column(network: Option<&str>) -> String {
    network.map_or_else(|| "LPIPS (no weights)".to_owned(), |network| format!("LPIPS ({network})"))
}

/// dB with two digits; `inf` for equal images, `-` where there is none.
#[must_use]
pub fn decibel(value: f64) -> String {
    number(value, 2)
}

/// A number with `digits` behind the point; `-` where there is none.
#[must_use]
pub fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{value:.digits$}") }
}

/// A count, rounded, in groups of three digits.
#[must_use]
pub fn count(value: f64) -> String {
    if value.is_nan() {
        return "-".to_owned();
    }
    let digits = format!("{value:.0}");
    let mut grouped = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            grouped.push(' ');
        }
        grouped.push(digit);
    }
    grouped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_and_names_are_on_the_left() {
        let mut table = Table::new(&["name", "n"], 1);
        table.push(vec!["a".into(), "1".into()]);
        table.push(vec!["longer".into(), "1000".into()]);
        assert_eq!(table.to_text(), "name       n\na          1\nlonger  1000\n");
        let markdown = "| name   |    n |\n| ------ | ---: |\n| a      |    1 |\n| longer | 1000 |\n";
        assert_eq!(table.to_markdown(), markdown);
    }

    #[test]
    fn counts_are_grouped() {
        assert_eq!(
            [0.0, 999.0, 1000.0, 40_000.4, 1_234_567.0].map(count),
            ["0", "999", "1 000", "40 000", "1 234 567"]
        );
        assert_eq!(count(f64::NAN), "-");
    }
}
