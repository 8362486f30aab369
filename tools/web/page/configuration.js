/* The configuration as a whole: presets, store and restore, differences, files, recording by the node. */
import {button, card, file_button, download, fill, h, labelled, list_table, option, say} from "./dom.js";
import {is_default, shown, writable} from "./field.js";
import {T} from "./strings.js";
import {label_of} from "./text.js";

const AT_ONCE = 60; /* objects read in one request */
const FILES = ".ini,.conf,.cfg,.dcf,.txt";
const GROUPS = ["all", "communication", "application", "manufacturer"];
const format_of = (name) => (/\.(?:dcf|eds)$/i.test(name) ? "dcf" : "ini");

export function configuration_view(ctx, node) {
  const id = node.node,
    element = h("div", {class: "stack columns"});

  /* -- presets */
  function preset(object) {
    const select = h(
      "select",
      {},
      Object.entries(object.words).map(([value, word]) =>
        option(value, T.presets.motion[word]?.title ?? label_of(word))
      )
    );
    const text = h("p", {class: "note", role: "status"});
    const explain = () => say(text, T.presets.motion[object.words[select.value]]?.text ?? "");
    select.addEventListener("change", explain);
    ctx.bus
      .request("read", {node: id, objects: [object.name]})
      .then(({values}) => {
        select.value = String(values[0]?.value);
        explain();
      })
      .catch(() => {});
    return card(
      T.presets.motion_title,
      h(
        "div",
        {class: "toolbar"},
        labelled(T.presets.motion_label, select, {class: "grow labelled"}),
        button(
          T.presets.apply,
          async () => {
            if (
              await ctx.act("write", {
                node: id,
                object: object.name,
                value: Number(select.value),
              })
            )
              ctx.toast(T.presets.applied);
          },
          {class: "primary"}
        )
      ),
      text
    );
  }

  /* -- store, restore */
  const group = h(
    "select",
    {},
    GROUPS.map((key) => option(key, T.configuration.groups[key]))
  );
  const storing = card(
    T.configuration.keep,
    h("p", {}, T.configuration.keep_text),
    h(
      "div",
      {class: "toolbar"},
      labelled(T.configuration.group, group, {class: "grow labelled"}),
      button(
        T.configuration.store,
        async () => {
          if (await ctx.act("store", {node: id, group: group.value})) ctx.toast(T.configuration.stored);
        },
        {class: "primary", "data-do": "store"}
      ),
      button(
        T.configuration.restore,
        async () => {
          if (
            (await ctx.confirm(
              T.configuration.restore_ask(T.configuration.groups[group.value]),
              T.configuration.restore
            )) &&
            (await ctx.act("restore", {node: id, group: group.value}))
          )
            ctx.toast(T.configuration.restored);
        },
        {class: "danger"}
      )
    )
  );

  /* -- differences */
  const differences = h("div", {}),
    note = h("p", {class: "note", role: "status"});
  function row({name, node_value, file_value}, objects, set_text) {
    const object = objects.by_name.get(name) ?? {name};
    const value = h("td", {class: "number"}, shown(object, node_value));
    const set = button(
      set_text,
      async () => {
        if (!(await ctx.act("write", {node: id, object: name, value: file_value}))) return;
        say(value, shown(object, file_value));
        set.disabled = true;
      },
      {class: "small"}
    );
    /* PDOs change only as a whole, by the procedure of CiA 301 */
    const of_pdo = object.index >= "1400h" && object.index < "1C00h";
    const way = of_pdo ? h("a", {href: `#/node/${id}/pdos`}, T.tabs.pdos) : object.stored ? set : null;
    const wanted = h("td", {class: "number"}, shown(object, file_value));
    return h("tr", {"data-object": name}, h("th", {scope: "row"}, label_of(name)), value, wanted, h("td", {}, way));
  }
  function show(rows, other, objects, set_text) {
    const body = h(
      "tbody",
      {},
      rows.map((found) => row(found, objects, set_text))
    );
    const headings = [T.configuration.object, T.configuration.node_value, other, null];
    fill(differences, rows.length ? list_table(headings, body) : null);
    say(note, T.configuration.differences(rows.length));
  }
  async function with_defaults() {
    say(note, T.loading);
    const objects = await ctx.objects(id);
    const wanted = objects.list.filter((o) => o.stored && writable(o) && o.default !== undefined && o.default !== null);
    const rows = [];
    for (let i = 0; i < wanted.length; i += AT_ONCE) {
      const {values} = await ctx.bus.request("read", {
        node: id,
        objects: wanted.slice(i, i + AT_ONCE).map((o) => o.name),
      });
      for (const {name, value} of values) {
        const object = objects.by_name.get(name);
        if (object && is_default(object, value) === false)
          rows.push({name, node_value: value, file_value: object.default});
      }
      say(note, T.configuration.compared(Math.min(i + AT_ONCE, wanted.length), wanted.length));
    }
    show(rows, T.configuration.default_value, objects, T.configuration.set_default);
  }
  async function with_file(file) {
    say(note, T.loading);
    const found = await ctx.bus.request("compare", {
      node: id,
      format: format_of(file.name),
      text: file.text,
    });
    show(found.differences, file.name, await ctx.objects(id), T.configuration.set_file);
  }
  const guarded = (f) => (file) => f(file).catch((error) => say(note, error.message));
  const comparing = card(
    T.configuration.compare,
    h(
      "div",
      {class: "actions"},
      button(T.configuration.with_defaults, guarded(with_defaults)),
      file_button(T.configuration.with_file, FILES, guarded(with_file))
    ),
    note,
    differences
  );

  /* -- files */
  const loaded = h("div", {});
  async function save(format) {
    const {text} = await ctx.bus.request("save", {node: id, format});
    download(`node-${id}.${format}`, text);
  }
  async function load(file) {
    const done = await ctx.act("load", {node: id, format: format_of(file.name), text: file.text});
    if (done)
      fill(
        loaded,
        h(
          "p",
          {class: done.failed.length ? "error" : "good", role: "status"},
          T.configuration.loaded(done.written, done.failed.length)
        ),
        h(
          "ul",
          {},
          done.failed.map((failed) => h("li", {}, `${label_of(failed.name)}: ${failed.error}`))
        )
      );
  }
  const show_error = (error) => ctx.toast(error.message, "bad");
  const files = card(
    T.configuration.files,
    h("p", {}, T.configuration.files_text),
    h(
      "div",
      {class: "actions"},
      button(T.configuration.save_ini, () => save("ini").catch(show_error)),
      button(T.configuration.save_dcf, () => save("dcf").catch(show_error)),
      file_button(T.configuration.load, FILES, load)
    ),
    loaded
  );

  /* -- recording on the node */
  function recording() {
    const state = h("p", {class: "note", role: "status"});
    const show = () =>
      ctx.bus
        .request("read", {node: id, objects: ["recording.state"]})
        .then(({values}) => say(state, T.configuration.recording_state(values[0]?.words ?? "?")))
        .catch((error) => say(state, error.message));
    const set = (on) => async () => (await ctx.act("record", {node: id, on})) && show();
    show();
    return card(
      T.configuration.recording,
      h("p", {}, T.configuration.recording_text),
      h("div", {class: "actions"}, button(T.record.start, set(true)), button(T.record.stop, set(false))),
      state
    );
  }

  comparing.classList.add("wide");
  fill(element, storing, files, comparing);
  ctx
    .objects(id)
    .then((objects) => {
      const motion = objects.by_name.get("position.motion_preset");
      if (motion?.words) element.prepend(preset(motion));
      if (objects.by_name.has("recording.state")) comparing.before(recording());
    })
    .catch(show_error);
  return {element, close() {}};
}
