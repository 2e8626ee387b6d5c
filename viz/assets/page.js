// A page of one scene: the data inside, and the component that draws them.
(async function () {
  "use strict";
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const packed = new Blob([bytes(document.getElementById("data").textContent)]);
  const text = await new Response(packed.stream().pipeThrough(new DecompressionStream("deflate"))).text();
  const parts = JSON.parse(text, (_, value) => (value?.base64 === undefined ? value : bytes(value.base64)));
  const label = "Scene in 3D: drag or arrow keys turn it, wheel or plus and minus zoom, Home resets";
  const scene = Vue.createApp(window.meshtraceScene, { label, caption: "" }).mount("#scene");
  scene.show(parts);
  document.getElementById("home").addEventListener("click", () => scene.home());
})();
