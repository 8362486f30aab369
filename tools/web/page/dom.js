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

/** A file of the user's, as {name, text}; null when none was chosen. */
export function choose_file(accept) {
  return new Promise((done) => {
    const input = h("input", {type: "file", accept});
    input.addEventListener("change", async () => {
      const file = input.files[0];
      done(file ? {name: file.name, text: await file.text()} : null);
    });
    input.addEventListener("cancel", () => done(null));
    input.click();
  });
}

export function download(name, text, type = "text/plain") {
  const url = URL.createObjectURL(new Blob([text], {type}));
  h("a", {href: url, download: name}).click();
  setTimeout(() => URL.revokeObjectURL(url), 60000);
}
