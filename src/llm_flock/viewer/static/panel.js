import { build } from "llm-flock-viewer";

export default {
  template: `<div class="flock-part"></div>`,
  props: { kind: String, options: Object },
  mounted() {
    this.part = build(this.kind, this.$el, this.options, (name, value) => this.$emit(name, value));
  },
  unmounted() {
    this.part.close();
  },
  methods: {
    call(name, ...given) {
      return this.part[name](...given);
    },
  },
};
