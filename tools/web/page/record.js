/* Records what comes in PDOs, in the browser, and gives it as CSV. */
import {to_csv} from "./csv.js";
import {button, download, h, say} from "./dom.js";
import {T} from "./strings.js";

const MOST_ROWS = 500000; /* an hour and more at 100 Hz; some 100 MB */

export class Recorder {
  constructor(node) {
    this.node = node;
    this.fields = [];
    this.recorded = null;
    this.text = h("span", {class: "note", role: "status"});
    this.toggle = button(T.record.start, () => (this.recorded ? this.end() : this.begin()), {
      class: "record",
    });
    this.element = h("div", {class: "recorder"}, this.text, this.toggle);
  }

  map(fields) {
    if (this.recorded?.length && String(fields.map((f) => f.name)) !== String(this.fields.map((f) => f.name)))
      this.end();
    this.fields = fields;
  }

  begin() {
    this.recorded = [];
    this.show();
  }

  rows(rows) {
    if (!this.recorded) return;
    for (const row of rows) this.recorded.push(row);
    this.show();
    if (this.recorded.length >= MOST_ROWS) this.end();
  }

  show() {
    const n = this.recorded?.length ?? 0,
      seconds = n ? this.recorded[n - 1][0] - this.recorded[0][0] : 0;
    say(this.text, this.recorded ? T.record.rows(n, seconds) : "");
    say(this.toggle, this.recorded ? T.record.end : T.record.start);
    this.toggle.classList.toggle("on", Boolean(this.recorded));
  }

  /** The file has a column for each field: its name, with the PDO where the name is there more than once, and unit. */
  end() {
    const names = this.fields.map((field) => field.name);
    const header = this.fields.map((field) => {
      const twice = names.indexOf(field.name) !== names.lastIndexOf(field.name);
      return `${field.name}${twice ? `@tpdo${field.pdo}` : ""}${field.unit ? ` [${field.unit}]` : ""}`;
    });
    const rows = this.recorded;
    this.recorded = null;
    this.show();
    download(T.record.file(this.node), to_csv(["t [s]", ...header], rows), "text/csv");
  }
}
