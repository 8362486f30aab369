/* Comma-separated values (RFC 4180, lines end in LF). */

function cell(value) {
  if (value === null || value === undefined) return "";
  const text = String(value);
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** Text of a header and rows, each an array. null is an empty cell. */
export const to_csv = (header, rows) => [header, ...rows].map((row) => row.map(cell).join(",") + "\n").join("");
