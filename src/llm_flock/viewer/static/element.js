import { build } from "llm-flock-viewer";

export default {
  template: `<div class="flock-part"></div>`,
  props: { kind: String, options: Object },
  mounted() {
    this.canvas = build(this.kind, this.$el, this.options, (name, value) => this.$emit(name, value));
  },
  unmounted() {
    this.canvas.close();
  },
  methods: {
    call(name, ...options) {
      return this.canvas[name](...options);
    },
  },
};
