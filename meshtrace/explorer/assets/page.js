// Components of the explorer's page: views in which lamp and receiver are dragged, charts, copying.
(function () {
  "use strict";
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
      image: { type: Object, default: null }, faded: Boolean, side: Boolean,
    },
    mixins: [sized],
    emits: ["movelamp", "movereceiver"],
    data: () => ({ held: null, kept: null, waiting: false, h: 240 }),
    computed: {
      seen() { return this.kept || this.frame; },
      scale() {
        const f = this.seen;
        return Math.min((this.w - 46) / (f.x1 - f.x0), (this.h - 50) / (f.y1 - f.y0));
      },
      box() {
        const f = this.seen, s = this.scale, w = s * (f.x1 - f.x0), h = s * (f.y1 - f.y0);
        return { left: 38 + (this.w - 46 - w) / 2, top: 24 + (this.h - 58 - h) / 2, w, h };
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
      cone(part) {
        if (!this.side || !part || !(part.half > 0 && part.half < 85)) return "";
        const edge = (sign) => {
          const angle = part.axis + (sign * part.half * Math.PI) / 180;
          const rise = Math.cos(angle);
          if (Math.abs(rise) < 0.02 || part.y * rise > 0) return null;
          return this.at(part.x - part.y * Math.tan(angle), 0);
        };
        const a = edge(-1), b = edge(1);
        return a && b ? `M${this.at(part.x, part.y)} L${a} L${b} Z` : "";
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
        if (this.side) y = this[name].air ? Math.max(y, 0.5) : Math.min(y, -0.5);
        this.$emit(`move${name}`, { x: round(x, 0.1), y: round(y, 0.1) });
        requestAnimationFrame(() => { this.waiting = false; });
      },
      stop() { this.held = null; this.kept = null; },
    },
    template: `
      <div class="mt-drag" :class="{ 'mt-faded': faded }">
        <svg ref="svg" :width="w" :height="h">
          <text class="mt-title" x="8" y="15">{{ title }}</text>
          <text class="mt-hint" :x="w - 8" y="15" text-anchor="end">drag lamp or receiver</text>
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
              <text :x="at(x, 0)[0]" :y="box.top + box.h + 15" text-anchor="middle">{{ x }}</text>
            </g>
            <g v-for="y in ys" :key="'y' + y">
              <line :y1="at(0, y)[1]" :y2="at(0, y)[1]" :x1="box.left - 4" :x2="box.left" />
              <text :y="at(0, y)[1] + 3.5" :x="box.left - 7" text-anchor="end">{{ y }}</text>
            </g>
            <text :x="box.left + box.w / 2" :y="h - 4" text-anchor="middle">{{ across }} [m]</text>
            <text :transform="'translate(' + (box.left - 28) + ',' + (box.top + box.h / 2) + ') rotate(-90)'" text-anchor="middle">{{ up }} [m]</text>
          </g>
          <g v-if="wind !== null" class="mt-wind" :transform="'translate(' + (box.left + 24) + ',' + (box.top + box.h - 22) + ') rotate(' + (-wind) + ')'">
            <path d="M-14 0 H10 M4 -5 L12 0 L4 5" />
          </g>
          <text v-if="wind !== null" class="mt-hint" :x="box.left + 24" :y="box.top + box.h - 5" text-anchor="middle">wind</text>
          <g v-if="lamp" class="mt-handle" data-part="lamp" :transform="'translate(' + at(lamp.x, lamp.y) + ')'"
             @pointerdown="start('lamp', $event)" @pointermove="drag" @pointerup="stop" @pointercancel="stop">
            <circle class="mt-grip" r="14" />
            <path v-if="lamp.air" class="mt-uav" d="M-12 -6 H-4 M4 -6 H12 M-8 -6 L-4 0 H4 L8 -6" /><circle class="mt-lamp" r="6.5" />
            <text x="-11" y="4" text-anchor="end">lamp</text>
          </g>
          <g v-if="receiver" class="mt-handle" data-part="receiver" :transform="'translate(' + at(receiver.x, receiver.y) + ')'"
             @pointerdown="start('receiver', $event)" @pointermove="drag" @pointerup="stop" @pointercancel="stop">
            <circle class="mt-grip" r="14" />
            <path v-if="receiver.air" class="mt-uav" d="M-11 -5 H-3 M3 -5 H11 M-7 -5 L-3 0 H3 L7 -5" />
            <circle class="mt-receiver" r="4.5" />
            <text x="13" y="4">{{ receiver.air ? "UAV" : "receiver" }}</text>
          </g>
        </svg>
      </div>`,
  };

  const Series = {
    // Gain over time relative to its mean, with the present time; emits `seek`.
    mixins: [sized],
    props: { time: Array, gain: Array, duration: Number, now: Number, faded: Boolean },
    emits: ["seek"],
    computed: {
      ends() {
        if (!this.gain.length) return [0.9, 1.1];
        const low = Math.min(...this.gain), high = Math.max(...this.gain);
        const room = 0.08 * Math.max(high - low, 0.02);
        return [low - room, high + room];
      },
      path() {
        return this.gain.map((g, i) => `${i ? "L" : "M"}${this.x(this.time[i])} ${this.y(g)}`).join(" ");
      },
      xs() { return ticks(0, this.duration || 1, 6); },
      ys() { return ticks(this.ends[0], this.ends[1], 4); },
      current() {
        if (!this.gain.length || this.now > this.time[this.time.length - 1] + 0.2) return null;
        const step = this.time[1] - this.time[0];
        const i = Math.min(Math.round(this.now / step), this.gain.length - 1);
        return i >= 0 ? this.gain[i] : null;
      },
    },
    methods: {
      x(t) { return Number((46 + ((this.w - 56) * t) / (this.duration || 1)).toFixed(2)); },
      y(g) {
        const [low, high] = this.ends;
        return Number((this.h - 32 - ((this.h - 58) * (g - low)) / (high - low)).toFixed(2));
      },
      seek(event) {
        const x = event.clientX - this.$refs.svg.getBoundingClientRect().left;
        const t = ((x - 46) / (this.w - 56)) * this.duration;
        if (t >= 0 && t <= this.duration) this.$emit("seek", round(t, 0.01));
      },
    },
    template: `
      <div class="mt-chart" :class="{ 'mt-faded': faded }">
        <svg ref="svg" :width="w" :height="h" @click="seek">
          <text class="mt-title" x="8" y="15">Gain over time / mean</text>
          <g class="mt-axis">
            <g v-for="t in xs" :key="'t' + t"><line :x1="x(t)" :x2="x(t)" :y1="h - 32" :y2="h - 28" />
              <text :x="x(t)" :y="h - 17" text-anchor="middle">{{ t }}</text></g>
            <g v-for="g in ys" :key="'g' + g"><line class="mt-grid" :x1="46" :x2="w - 10" :y1="y(g)" :y2="y(g)" />
              <text x="41" :y="y(g) + 3.5" text-anchor="end">{{ g }}</text></g>
            <text :x="46 + (w - 56) / 2" :y="h - 3" text-anchor="middle">time [s]</text>
          </g>
          <path class="mt-line" :d="path" />
          <line class="mt-now" :x1="x(now)" :x2="x(now)" :y1="24" :y2="h - 32" />
          <circle v-if="current !== null" class="mt-now" :cx="x(now)" :cy="y(current)" r="4" />
        </svg>
      </div>`,
  };

  const Histogram = {
    // Histogram of the gain relative to its mean.
    mixins: [sized],
    props: { gain: Array, faded: Boolean },
    computed: {
      bins() {
        const n = 16, g = this.gain;
        if (g.length < 8) return { low: 0.9, high: 1.1, counts: [], most: 1 };
        const low = Math.min(...g), high = Math.max(...g, low + 1e-6), counts = Array(n).fill(0);
        g.forEach((v) => { counts[Math.min(Math.floor(((v - low) / (high - low)) * n), n - 1)]++; });
        return { low, high, counts, most: Math.max(...counts) };
      },
      xs() { return ticks(this.bins.low, this.bins.high, 5); },
      width() { return (this.w - 32) / Math.max(this.bins.counts.length, 1); },
    },
    methods: {
      x(v) { return 16 + ((this.w - 32) * (v - this.bins.low)) / (this.bins.high - this.bins.low); },
    },
    template: `
      <div class="mt-chart" :class="{ 'mt-faded': faded }">
        <svg :width="w" :height="h">
          <rect v-for="(count, i) in bins.counts" :key="i" class="mt-bar" :x="16 + i * width + 0.5" :width="Math.max(width - 1, 1)"
            :y="h - 30 - (h - 36) * count / bins.most" :height="(h - 36) * count / bins.most" />
          <g class="mt-axis"><line :x1="16" :x2="w - 16" :y1="h - 30" :y2="h - 30" />
            <text v-for="v in xs" :key="v" :x="x(v)" :y="h - 17" text-anchor="middle">{{ v }}</text>
            <text :x="w / 2" :y="h - 3" text-anchor="middle">gain / mean</text></g>
        </svg>
      </div>`,
  };

  const Copy = {
    // Button that copies a text, also where the page is no secure context.
    props: { text: String },
    data: () => ({ done: false }),
    methods: {
      async copy() {
        try {
          await navigator.clipboard.writeText(this.text);
        } catch (error) {
          const area = document.createElement("textarea");
          area.value = this.text;
          this.$el.appendChild(area);
          area.select();
          document.execCommand("copy");
          area.remove();
        }
        this.done = true;
        setTimeout(() => { this.done = false; }, 1500);
      },
    },
    template: `<button class="mt-copy" type="button" @click="copy">{{ done ? "Copied" : "Copy" }}</button>`,
  };

  const Picture = {
    // Downloads a picture of the scene with a caption below it.
    props: { shot: { default: null }, caption: String },
    watch: {
      shot(blob) {
        if (!blob) return;
        const image = new Image();
        image.onload = () => {
          const size = Math.max(Math.round(image.width / 70), 12), room = 2.6 * size;
          const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
          canvas.width = image.width;
          canvas.height = image.height + room;
          pen.fillStyle = "#ffffff";
          pen.fillRect(0, 0, canvas.width, canvas.height);
          pen.drawImage(image, 0, 0);
          pen.fillStyle = "#1f2933";
          pen.font = `${size}px Roboto, sans-serif`;
          pen.fillText(this.caption, size, image.height + 1.6 * size, canvas.width - 2 * size);
          const link = document.createElement("a");
          link.download = "meshtrace.png";
          link.href = canvas.toDataURL("image/png");
          link.click();
          URL.revokeObjectURL(image.src);
        };
        image.src = URL.createObjectURL(blob);
      },
    },
    template: "<span></span>",
  };

  window.meshtrace = {
    install(app) {
      const parts = { Drag, Series, Histogram, Copy, Picture };
      for (const [name, part] of Object.entries(parts)) app.component(`mt-${name.toLowerCase()}`, part);
    },
  };
})();
