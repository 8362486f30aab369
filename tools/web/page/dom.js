/* Elements without HTML in strings: what a node sends is text, and never becomes markup. */

const SVG = "http://www.w3.org/2000/svg";

function add(element, children) {
  for (const child of children.flat(Infinity))
    if (child !== null && child !== undefined && child !== false) element.append(child);
  return element;
}

function set(element, properties) {
  for (const [key, value] of Object.entries(properties ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key === "value" || key === "checked" || key === "indeterminate") element[key] = value;
    else element.setAttribute(key, value === true ? "" : value);
  }
  return element;
}

/** h("p", {class: "note", onclick: f}, "text", child, [children]): an element of HTML. */
export const h = (tag, properties, ...children) => add(set(document.createElement(tag), properties), children);

/** Likewise, of SVG. */
export const svg = (tag, properties, ...children) => add(set(document.createElementNS(SVG, tag), properties), children);

/** Makes these the only children. */
export function fill(element, ...children) {
  element.replaceChildren();
  return add(element, children);
}

/** Changes the text only if it is another one: a screen reader announces a live region at each change. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

let ids = 0;
export const id = (prefix) => `${prefix}-${++ids}`;

export const button = (text, onclick, properties) => h("button", {type: "button", onclick, ...properties}, text);

/** A label before its field, which gets an id. */
export function labelled(text, field, properties) {
  field.id ||= id("field");
  return h("div", {class: "labelled", ...properties}, h("label", {for: field.id}, text), field);
}

export const option = (value, text, selected) => h("option", {value, selected: selected && "selected"}, text);

/** A button that asks for a file; f gets {name, text}. */
export function file_button(text, accept, f, properties) {
  const input = h("input", {type: "file", accept, class: "unseen"});
  input.addEventListener("change", async () => {
    const file = input.files[0];
    if (!file) return;
    const content = await file.text();
    input.value = ""; /* the same file can be chosen again */
    f({name: file.name, text: content});
  });
  return h("label", {class: "button", ...properties}, text, input);
}

export function download(name, text, type = "text/plain") {
  const url = URL.createObjectURL(new Blob([text], {type}));
  h("a", {href: url, download: name}).click();
  setTimeout(() => URL.revokeObjectURL(url), 60000);
}

/** A part of a view, with its title. */
export const card = (title, ...children) =>
  h("section", {class: "card", "aria-label": title}, h("header", {}, h("h2", {}, title)), ...children);

/** headings: texts, or null for a column without one. */
export const list_table = (headings, body) =>
  h(
    "table",
    {class: "list"},
    h(
      "thead",
      {},
      h(
        "tr",
        {},
        headings.map((text) => (text ? h("th", {scope: "col"}, text) : h("td", {})))
      )
    ),
    body
  );
