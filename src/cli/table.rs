use comfy_table::{Table, presets};

/// Rows under a header, in columns that are aligned by spaces, for people and for tools such as `awk`.
pub(super) fn table<const N: usize>(header: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> String {
    let mut table = Table::new();
    table.load_style(presets::NOTHING).set_header(header).add_rows(rows);
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table.trim_fmt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_columns_of_a_table_begin_below_one_another_and_lines_end_without_spaces() {
        let rows = [["a", "1"], ["long name", "22"]].map(|row| row.map(str::to_owned));
        assert_eq!(table(["NAME", "N"], rows), "NAME       N\na          1\nlong name  22");
    }
}
