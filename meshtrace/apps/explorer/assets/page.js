// Components of the explorer's page: views in which lamp and receiver are dragged, charts, texts, links.
(function () {
  "use strict";
  // wslink reads every message as a Blob, of which small ones overtake large ones: rays their sea
  const read = Blob.prototype.arrayBuffer;
  let last = Promise.resolve();
  Blob.prototype.arrayBuffer = function () {
    const found = last.then(() => read.call(this));
    last = found.catch(() => {});
    return found;
  };

  const round = (value, step) => Number((Math.round(value / step) * step).toFixed(3));
  const nice = (span, count) => {
    const raw = span / count, power = Math.pow(10, Math.floor(Math.log10(raw)));
    return [1, 2, 5, 10].map((m) => m * power).find((step) => step >= raw);
  };
  const ticks = (low, high, count) => {
    const step = nice(high - low, count), found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
      found.push(Number((k * step).toPrecision(12)));
    return found;
  };

  const sized = {
    // Width and height [px] of an element, followed as it is resized.
    data: () => ({ w: 300, h: 130 }),
    mounted() {
      const measure = () => {
        if (!this.$el.clientWidth) return;
        this.w = this.$el.clientWidth;
        this.h = this.$el.clientHeight;
      };
      this.watcher = new ResizeObserver(measure);
      this.watcher.observe(this.$el);
      measure();
    },
    unmounted() { this.watcher.disconnect(); },
  };

  const Drag = {
    // Side view (x, z) or plan (x, y) in equal scales; emits `movelamp` and `movereceiver` while dragged.
    props: {
      title: String, across: String, up: String, frame: Object, lamp: Object, receiver: Object,
      profile: { type: Array, default: () => [] }, wind: { type: Number, default: null },
      image: { type: Object, default: null }, side: Boolean,
    },
    mixins: [sized],
    emits: ["movelamp", "movereceiver"],
    data: () => ({ held: null, kept: null, waiting: false, h: 240 }),
    computed: {
      seen() { return this.kept || this.frame; },
      scale() {
        const f = this.seen;
        return Math.min((this.w - 54 - this.room) / (f.x1 - f.x0), (this.h - 62) / (f.y1 - f.y0));
      },
      room() { return this.image ? 74 : 0; }, // for the colours of the map
      box() {
        const f = this.seen, s = this.scale, w = s * (f.x1 - f.x0), h = s * (f.y1 - f.y0);
        return { left: 46 + (this.w - 54 - this.room - w) / 2, top: 24 + (this.h - 62 - h) / 2, w, h };
      },
      xs() { return ticks(this.seen.x0, this.seen.x1, 4); },
      ys() { return ticks(this.seen.y0, this.seen.y1, 4); },
      water() {
        const line = this.profile.map((p) => this.at(p[0], p[1]).join(" "));
        if (!line.length) return "";
        const f = this.seen;
        return `M${this.at(f.x0, f.y0)} L${line.join(" L")} L${this.at(f.x1, f.y0)} Z`;
      },
      beam() { return this.cone(this.lamp); },
      view() { return this.cone(this.receiver); },
    },
    methods: {
      at(x, y) {
        const f = this.seen, b = this.box;
        const px = b.left + (x - f.x0) * this.scale, py = b.top + (f.y1 - y) * this.scale;
        return [Number(px.toFixed(2)), Number(py.toFixed(2))];
      },
      wave(x) { // elevation of the drawn waves
        const line = this.profile, k = line.findIndex((p) => p[0] >= x);
        if (k < 1) return line.length ? line[k < 0 ? line.length - 1 : 0][1] : 0;
        const [a, b] = [line[k - 1], line[k]];
        return a[1] + ((b[1] - a[1]) * (x - a[0])) / (b[0] - a[0] || 1);
      },
      edge(part, sign) { // where a side of a cone meets the waves, or leaves the picture
        const angle = part.axis + (sign * part.half * Math.PI) / 180, f = this.seen;
        const at = (t) => [part.x + t * Math.sin(angle), part.y + t * Math.cos(angle)];
        const above = (t) => (at(t)[1] > this.wave(at(t)[0])) === part.air, step = (f.x1 - f.x0) / 60;
        let t = 0;
        while (above(t)) {
          t += step;
          const [x, y] = at(t);
          if (x < f.x0 || x > f.x1 || y < f.y0 || y > f.y1) return at(t);
        }
        let low = Math.max(t - step, 0);
        for (let k = 0; k < 12; k++) {
          const half = (low + t) / 2;
          if (above(half)) low = half;
          else t = half;
        }
        return at(t);
      },
      cone(part) {
        if (!this.side || !part || !(part.half > 0 && part.half < 85)) return "";
        const ends = [this.edge(part, -1), this.edge(part, 1)].sort((a, b) => a[0] - b[0]);
        const between = this.profile.filter((p) => p[0] > ends[0][0] && p[0] < ends[1][0]);
        const rim = [ends[0], ...between, ends[1]].map((p) => this.at(...p).join(" "));
        return `M${this.at(part.x, part.y)} L${rim.join(" L")} Z`;
      },
      key(name, event) {
        const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
        if (!step) return;
        const size = event.shiftKey ? 0.1 : 0.5, part = this[name];
        this.put(name, part.x + size * step[0], part.y + size * step[1]);
        event.preventDefault();
      },
      put(name, x, y) {
        if (this.side) y = this[name].air ? Math.max(y, 0.5) : Math.min(y, -0.5);
        this.$emit(`move${name}`, { x: round(x, 0.1), y: round(y, 0.1) });
      },
      words(part) { return part && `x ${part.x.toFixed(1)} m, ${this.up} ${part.y.toFixed(1)} m`; },
      label(name) { // beside its part, away from the other one and from the sides of the view
        const part = this[name], other = name === "lamp" ? this.receiver : this.lamp;
        const [x, y] = this.at(part.x, part.y), [u, v] = other ? this.at(other.x, other.y) : [1e4, 1e4];
        const text = name === "lamp" ? "lamp" : part.air ? "receiver (UAV)" : "receiver";
        const wide = 6.2 * text.length, end = this.image ? this.box.left + this.box.w + 12 : this.w; // or the colours of the map
        const near = Math.abs(y - v) < 22 && Math.abs(x - u) < 90, far = x + 14 + wide > end;
        if (near && far) { // above or below
          const middle = x + wide / 2 < end;
          return { x: middle ? 0 : -14, y: name === "lamp" ? 22 : -14, anchor: middle ? "middle" : "end", text };
        }
        const left = far || (near && (x < u || (x === u && name === "lamp")));
        return { x: left ? -14 : 14, y: part.air && this.side ? 9 : 4, anchor: left ? "end" : "start", text }; // below the rotors
      },
      start(name, event) {
        this.held = name;
        this.kept = { ...this.frame };
        event.currentTarget.setPointerCapture(event.pointerId);
        event.preventDefault();
      },
      drag(event) {
        if (!this.held || this.waiting) return;
        this.waiting = true; // at most once for each picture
        const name = this.held, rect = this.$refs.svg.getBoundingClientRect();
        const f = this.seen, b = this.box;
        let x = f.x0 + (event.clientX - rect.left - b.left) / this.scale;
        let y = f.y1 - (event.clientY - rect.top - b.top) / this.scale;
        x = Math.min(Math.max(x, f.x0), f.x1);
        y = Math.min(Math.max(y, f.y0), f.y1);
        this.put(name, x, y);
        requestAnimationFrame(() => { this.waiting = false; });
      },
      stop() { this.held = null; this.kept = null; },
    },
    template: `
      <div class="mt-drag">
        <svg ref="svg" :width="w" :height="h" role="group" :aria-label="title">
          <text class="mt-title" x="10" y="16">{{ title }}</text>
          <text class="mt-hint" :x="w - 10" y="16" text-anchor="end">drag, or arrow keys</text>
          <clipPath :id="'clip-' + up"><rect :x="box.left" :y="box.top" :width="box.w" :height="box.h" /></clipPath>
          <rect class="mt-field" :x="box.left" :y="box.top" :width="box.w" :height="box.h" />
          <g :clip-path="'url(#clip-' + up + ')'">
            <image v-if="image" :href="image.url" :x="at(image.x0, image.y1)[0]" :y="at(image.x0, image.y1)[1]"
              :width="(image.x1 - image.x0) * scale" :height="(image.y1 - image.y0) * scale" preserveAspectRatio="none" />
            <path v-if="water" class="mt-water" :d="water" />
            <path v-if="beam" class="mt-beam" :d="beam" />
            <path v-if="view" class="mt-view" :d="view" />
          </g>
          <g class="mt-axis">
            <g v-for="x in xs" :key="'x' + x">
              <line :x1="at(x, 0)[0]" :x2="at(x, 0)[0]" :y1="box.top + box.h" :y2="box.top + box.h + 4" />
              <text :x="at(x, 0)[0]" :y="box.top + box.h + 16" text-anchor="middle">{{ x }}</text>
            </g>
            <g v-for="y in ys" :key="'y' + y">
              <line :y1="at(0, y)[1]" :y2="at(0, y)[1]" :x1="box.left - 4" :x2="box.left" />
              <text :y="at(0, y)[1] + 4" :x="box.left - 7" text-anchor="end">{{ y }}</text>
            </g>
            <text :x="box.left + box.w / 2" :y="box.top + box.h + 32" text-anchor="middle">{{ across }} [m]</text>
            <text :transform="'translate(' + (box.left - 33) + ',' + (box.top + box.h / 2) + ') rotate(-90)'" text-anchor="middle">{{ up }} [m]</text>
          </g>
          <g v-if="image" class="mt-axis mt-scale">
            <linearGradient id="mt-shades" x1="0" y1="1" x2="0" y2="0">
              <stop v-for="(c, i) in image.colors" :key="i" :offset="i / (image.colors.length - 1)" :stop-color="c" /></linearGradient>
            <rect :x="box.left + box.w + 14" :y="box.top + 16" width="12" :height="box.h - 16" fill="url(#mt-shades)" />
            <text :x="box.left + box.w + 14" :y="box.top + 8">gain</text>
            <text :x="box.left + box.w + 31" :y="box.top + 24">{{ image.most }}</text>
            <text :x="box.left + box.w + 31" :y="box.top + box.h">{{ image.least }}</text>
          </g>
          <g v-if="wind !== null" class="mt-wind">
            <path :transform="'translate(24,' + (h - 26) + ') rotate(' + (-wind) + ')'" d="M-12 0 H10 M4 -5 L12 0 L4 5" />
            <text class="mt-hint" x="24" :y="h - 6" text-anchor="middle">wind</text>
          </g>
          <template v-for="name in ['lamp', 'receiver']" :key="name">
            <g v-if="$props[name]" class="mt-handle" :data-part="name" :transform="'translate(' + at($props[name].x, $props[name].y) + ')'"
               tabindex="0" role="slider" :aria-label="title + ': ' + name" :aria-valuenow="$props[name].y" :aria-valuetext="words($props[name])"
               @pointerdown="start(name, $event)" @pointermove="drag" @pointerup="stop" @pointercancel="stop" @keydown="key(name, $event)">
              <circle class="mt-grip" r="15" />
              <path v-if="$props[name].air && side" class="mt-uav" d="M-13 -7 H-4 M4 -7 H13 M-8 -7 L-4 -1 H4 L8 -7" />
              <circle :class="'mt-' + name" :r="name === 'lamp' ? 7.5 : 4.5" />
              <text :x="label(name).x" :y="label(name).y" :text-anchor="label(name).anchor">{{ label(name).text }}</text>
            </g>
          </template>
        </svg>
      </div>`,
  };

  const Series = {
    // Gain over time in dB about its mean, the least one that closes, the present time and a kept series;
    // emits `seek`.
    mixins: [sized],
    props: { time: Array, gain: Array, duration: Number, now: Number, least: { type: Number, default: null }, faded: Boolean, other: { type: Object, default: null } },
    emits: ["seek"],
    computed: {
      ends() {
        const all = [...this.gain, ...(this.other?.gain ?? [])];
        if (!all.length) return [-1, 1];
        let low = Math.min(...all), high = Math.max(...all);
        if (Math.abs(this.least ?? 99) < 2 * (high - low)) [low, high] = [Math.min(low, this.least), Math.max(high, this.least)];
        const room = 0.08 * Math.max(high - low, 0.1);
        return [low - room, high + room];
      },
      step() { return Math.min(...this.time.slice(1).map((t, i) => t - this.time[i])); },
      path() { return this.line(this.time, this.gain); },
      kept() { return this.other ? this.line(this.other.time, this.other.gain) : ""; },
      xs() { return ticks(0, this.duration || 1, 6); },
      ys() { return ticks(this.ends[0], this.ends[1], 5); },
      current() {
        const i = this.time.findIndex((t) => Math.abs(t - this.now) <= 0.5 * this.step + 1e-9);
        return i < 0 ? null : this.gain[i];
      },
    },
    methods: {
      line(time, gain) { // gains that are left out are gaps
        return gain.map((g, i) => {
          const gap = i === 0 || time[i] - time[i - 1] > 1.5 * this.step;
          return `${gap ? "M" : "L"}${this.x(time[i])} ${this.y(g)}${gap ? " h0.01" : ""}`;
        }).join(" ");
      },
      x(t) { return Number((46 + ((this.w - 56) * t) / (this.duration || 1)).toFixed(2)); },
      y(g) {
        const [low, high] = this.ends;
        return Number((this.h - 36 - ((this.h - 62) * (g - low)) / (high - low)).toFixed(2));
      },
      seek(event) {
        const x = event.clientX - this.$refs.svg.getBoundingClientRect().left;
        const t = ((x - 46) / (this.w - 56)) * this.duration;
        if (t >= 0 && t <= this.duration) this.$emit("seek", round(t, 0.01));
      },
      key(event) {
        const to = { ArrowLeft: this.now - 0.125, ArrowRight: this.now + 0.125, Home: 0, End: this.duration }[event.key];
        if (to === undefined) return;
        this.$emit("seek", round(Math.min(Math.max(to, 0), this.duration), 0.001));
        event.preventDefault();
      },
    },
    template: `
      <div class="mt-chart" :class="{ 'mt-faded': faded }">
        <svg ref="svg" :width="w" :height="h" @click="seek" @keydown="key" tabindex="0" role="slider" aria-label="Time of the sea in the series of gains"
          aria-valuemin="0" :aria-valuemax="duration" :aria-valuenow="now" :aria-valuetext="now.toFixed(2) + ' s'">
          <text class="mt-title" x="2" y="14">Gain over its mean [dB]</text>
          <g class="mt-axis">
            <g v-for="t in xs" :key="'t' + t"><line :x1="x(t)" :x2="x(t)" :y1="h - 36" :y2="h - 32" />
              <text :x="x(t)" :y="h - 20" text-anchor="middle">{{ t }}</text></g>
            <g v-for="g in ys" :key="'g' + g"><line class="mt-grid" :x1="46" :x2="w - 10" :y1="y(g)" :y2="y(g)" />
              <text x="41" :y="y(g) + 4" text-anchor="end">{{ g }}</text></g>
            <text :x="46 + (w - 56) / 2" :y="h - 4" text-anchor="middle">time [s]</text>
          </g>
          <path v-if="kept" class="mt-line mt-kept" :d="kept" />
          <path class="mt-line" :d="path" />
          <g v-if="least !== null && least > ends[0] && least < ends[1]" class="mt-axis"><line class="mt-least" :x1="46" :x2="w - 10" :y1="y(least)" :y2="y(least)" />
            <text class="mt-least" :x="w - 10" :y="y(least) - 4" text-anchor="end">closes above</text></g>
          <g v-if="kept && gain.length" class="mt-axis"><text class="mt-a" :x="w - 8" :y="y(other.gain[other.gain.length - 1]) - 6" text-anchor="end">A</text>
            <text class="mt-b" :x="w - 24" :y="y(gain[gain.length - 1]) - 6" text-anchor="end">B</text></g>
          <line class="mt-now" :x1="x(now)" :x2="x(now)" :y1="22" :y2="h - 36" />
          <circle v-if="current !== null" class="mt-now" :cx="x(now)" :cy="y(current)" r="4" />
        </svg>
      </div>`,
  };

  const Histogram = {
    // Histogram of the gain in dB about its mean, and the outline of a kept one.
    mixins: [sized],
    props: { gain: Array, faded: Boolean, other: { type: Object, default: null } },
    computed: {
      ends() {
        const all = [...this.gain, ...(this.other?.gain ?? [])];
        return all.length < 8 ? [-1, 1] : [Math.min(...all), Math.max(...all, Math.min(...all) + 1e-6)];
      },
      counts() { return this.count(this.gain); },
      others() { return this.other ? this.count(this.other.gain) : []; },
      most() { return Math.max(...this.counts, ...this.others, 1); },
      xs() { return ticks(...this.ends, 5); },
      width() { return (this.w - 32) / 16; },
      outline() {
        const at = this.others.map((c, i) => `L${16 + i * this.width} ${this.y(c)} H${16 + (i + 1) * this.width}`);
        return at.length ? `M16 ${this.y(0)} ${at.join(" ")} V${this.y(0)}` : "";
      },
    },
    methods: {
      count(gain) {
        const [low, high] = this.ends, counts = Array(16).fill(0);
        if (gain.length < 8) return [];
        gain.forEach((v) => { counts[Math.min(Math.floor(((v - low) / (high - low)) * 16), 15)]++; });
        return counts;
      },
      x(v) { return 16 + ((this.w - 32) * (v - this.ends[0])) / (this.ends[1] - this.ends[0]); },
      y(count) { return this.h - 36 - ((this.h - 42) * count) / this.most; },
    },
    template: `
      <div class="mt-chart" :class="{ 'mt-faded': faded }">
        <svg :width="w" :height="h" role="img" aria-label="Histogram of the gain over its mean [dB]">
          <rect v-for="(count, i) in counts" :key="i" class="mt-bar" :x="16 + i * width + 0.5" :width="Math.max(width - 1, 1)"
            :y="y(count)" :height="h - 36 - y(count)" />
          <path v-if="outline" class="mt-line mt-kept" :d="outline" />
          <g class="mt-axis"><line :x1="16" :x2="w - 16" :y1="h - 36" :y2="h - 36" />
            <text v-for="v in xs" :key="v" :x="x(v)" :y="h - 21" text-anchor="middle">{{ v }}</text>
            <text :x="w / 2" :y="h - 5" text-anchor="middle">gain over its mean [dB]</text></g>
        </svg>
      </div>`,
  };

  async function copied(text, element) {
    try {
      await navigator.clipboard.writeText(text);
    } catch (error) { // no secure context
      const area = document.createElement("textarea");
      area.value = text;
      element.appendChild(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
  }
  const copying = {
    data: () => ({ done: false }),
    methods: {
      async copy(text) {
        await copied(text, this.$el);
        this.done = true;
        setTimeout(() => { this.done = false; }, 1500);
      },
    },
  };

  const dialog = {
    props: { shown: Boolean },
    emits: ["close"],
    watch: {
      shown(now) {
        if (now && !this.$refs.dialog.open) this.$refs.dialog.showModal();
        if (!now) this.$refs.dialog.close();
      },
    },
    methods: {
      closed() { if (!this.$refs.dialog.open) this.$emit("close"); }, // told late: it may be open again
    },
  };

  const Design = {
    // Dialog with the answer, the tables and the notes of a design.
    mixins: [copying, dialog],
    props: { design: { type: Object, default: null }, stale: Boolean },
    template: `
      <dialog ref="dialog" class="mt-dialog mt-design" aria-labelledby="design-title" @close="closed">
        <div class="mt-top"><h2 id="design-title">Design</h2>
          <button type="button" id="design-close" @click="$emit('close')">Close</button>
          <button type="button" @click="copy(design.text)">{{ done ? "Copied" : "Copy as text" }}</button></div>
        <template v-if="design?.tables">
          <p v-if="stale" class="mt-note">Of an earlier state.</p>
          <p v-for="line in design.answer" :key="line">{{ line }}</p>
          <table v-for="t in design.tables" :key="t.title">
            <caption>{{ t.title }}</caption>
            <thead><tr><td></td><th v-for="h in t.head.slice(1)" :key="h" scope="col">{{ h }}</th></tr></thead>
            <tbody><tr v-for="[name, ...cells] in t.rows" :key="name" :class="{ 'mt-total': name.startsWith('=') }">
              <th scope="row">{{ name }}</th><td v-for="(cell, i) in cells" :key="i">{{ cell }}</td></tr></tbody>
          </table>
          <p v-for="note in design.notes" :key="note">{{ note }}</p>
        </template>
      </dialog>`,
  };

  const Text = {
    // Dialog with a text to be copied.
    mixins: [copying, dialog],
    props: { title: String, text: String },
    template: `
      <dialog ref="dialog" class="mt-dialog" aria-labelledby="text-title" @close="closed">
        <h2 id="text-title">{{ title }}</h2>
        <pre id="text" class="mt-text" tabindex="0">{{ text }}</pre>
        <div class="mt-actions"><button type="button" class="mt-copy mt-main" @click="copy(text)">{{ done ? "Copied" : "Copy" }}</button>
          <button type="button" id="close" @click="$emit('close')">Close</button></div>
      </dialog>`,
  };

  const Link = {
    // Button that copies a link to the state; the fragment of the address holds the moved controls.
    mixins: [copying],
    props: { moves: Object, base: String },
    emits: ["restore"],
    computed: {
      fragment() {
        const text = new URLSearchParams(Object.entries(this.moves)).toString();
        return text ? `#${text}` : "";
      },
    },
    watch: {
      // the whole address: that of the page has another base
      fragment(now) { history.replaceState(null, "", location.pathname + location.search + now); },
    },
    methods: {
      restore() {
        const found = [...new URLSearchParams(location.hash.slice(1))];
        this.$emit("restore", Object.fromEntries(found.map(([k, v]) => [k, v !== "" && isFinite(v) ? Number(v) : v])));
      },
    },
    mounted() {
      if (location.hash.length > 1) this.restore();
      window.addEventListener("hashchange", this.restore);
    },
    unmounted() { window.removeEventListener("hashchange", this.restore); },
    template: `<button type="button" id="link" @click="copy(base + fragment)">{{ done ? "Copied" : "Copy link" }}</button>`,
  };

  const Rows = {
    // Table of the texts of a reading by the labels of its keys, with those of state A before them.
    props: { name: String, labels: Object, texts: Object, other: { type: Object, default: null } },
    template: `<dl class="mt-rows"><div v-for="(label, key) in labels" :key="key"><dt>{{ label }}</dt>
      <dd v-if="other" class="mt-a">{{ other[key] }}</dd><dd :id="name + '-' + key">{{ texts[key] }}</dd></div></dl>`,
  };

  window.meshtrace = {
    install(app) {
      const parts = { Scene: window.meshtraceScene, Drag, Series, Histogram, Text, Design, Link, Rows };
      for (const [name, part] of Object.entries(parts)) app.component(`mt-${name.toLowerCase()}`, part);
    },
  };
})();
