/* The configuration as a whole: presets, store and restore, differences, files, recording by the node. */
import {button, choose_file, download, fill, h, labelled, option, say} from "./dom.js";
import {is_default, shown, writable} from "./field.js";
import {T} from "./strings.js";
import {label_of} from "./text.js";

const AT_ONCE = 60; /* objects read in one request */
const GROUPS = ["all", "communication", "application", "manufacturer"];
const format_of = (name) => (/\.(?:dcf|eds)$/i.test(name) ? "dcf" : "ini");

const card = (title, ...children) =>
  h("section", {class: "card", "aria-label": title}, h("header", {}, h("h2", {}, title)), ...children);

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
  function table(rows, other, objects, set_text) {
    fill(
      differences,
      rows.length
        ? h(
            "table",
            {class: "list"},
            h(
              "thead",
              {},
              h(
                "tr",
                {},
                [T.configuration.object, T.configuration.node_value, other, ""].map((text) =>
                  h("th", {scope: "col"}, text)
                )
              )
            ),
            h(
              "tbody",
              {},
              rows.map(({name, node_value, file_value}) => {
                const object = objects.by_name.get(name) ?? {name};
                const value = h("td", {class: "number"}, shown(object, node_value));
                const set = button(
                  set_text,
                  async () => {
                    if (
                      !(await ctx.act("write", {
                        node: id,
                        object: name,
                        value: file_value,
                      }))
                    )
                      return;
                    say(value, shown(object, file_value));
                    set.disabled = true;
                  },
                  {class: "small"}
                );
                return h(
                  "tr",
                  {"data-object": name},
                  h("th", {scope: "row"}, label_of(name)),
                  value,
                  h("td", {class: "number"}, shown(object, file_value)),
                  h("td", {}, object.stored ? set : null)
                );
              })
            )
          )
        : null
    );
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
    table(rows, T.configuration.default_value, objects, T.configuration.set_default);
  }
  async function with_file() {
    const file = await choose_file(".ini,.conf,.cfg,.dcf,.txt");
    if (!file) return;
    say(note, T.loading);
    const found = await ctx.bus.request("compare", {
      node: id,
      format: format_of(file.name),
      text: file.text,
    });
    table(found.differences, file.name, await ctx.objects(id), T.configuration.set_file);
  }
  const guarded = (f) => () => f().catch((error) => say(note, error.message));
  const comparing = card(
    T.configuration.compare,
    h(
      "div",
      {class: "actions"},
      button(T.configuration.with_defaults, guarded(with_defaults)),
      button(T.configuration.with_file, guarded(with_file))
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
  async function load() {
    const file = await choose_file(".ini,.conf,.cfg,.dcf,.txt");
    if (!file) return;
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
      button(T.configuration.load, load, {class: "primary"})
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

  fill(element, storing, comparing, files);
  ctx
    .objects(id)
    .then((objects) => {
      const motion = objects.by_name.get("position.motion_preset");
      if (motion?.words) element.prepend(preset(motion));
      if (objects.by_name.has("recording.state")) element.append(recording());
    })
    .catch(show_error);
  return {element, close() {}};
}
