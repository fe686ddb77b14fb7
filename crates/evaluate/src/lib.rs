//! Load, predict, render, measure: protocols, tables and the HTML report.
