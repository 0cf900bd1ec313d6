package leaprig;

/** Answers as the toolbox writes them: each number in Java's shortest text, followed by `_`. */
final class Text {
    static final String DONE = "done\n";
    static final String NAK = "nak\n";
    static final String INTERRUPTED = "interrupted\n";

    private Text() { }

    static StringBuilder add(StringBuilder to, double[] values) {
        for (int i = 0; i < values.length; i++) to.append(values[i]).append('_');
        return to;
    }

    static String line(double[] values) { return add(new StringBuilder(), values).append('\n').toString(); }

    static String ok(Word word, double... values) {
        return add(new StringBuilder("ok_").append(word.text).append('_'), values).append('\n').toString();
    }

    static String no(Word word, String why) {
        String name = word == null ? "word" : word.text.endsWith("_") ? word.text.substring(0, word.text.length() - 1) : word.text;
        return "no_" + name + '_' + plain(why) + "_\n";
    }

    static String stopped(String why) { return "stopped_" + plain(why) + "_\n"; }

    static String event(String what) { return "event_" + plain(what) + "_\n"; }

    /** Returns the text as one field: without `_`, and printable ASCII alone. */
    static String plain(String text) {
        StringBuilder kept = new StringBuilder();
        for (int i = 0; i < text.length() && i < 200; i++) {
            char c = text.charAt(i);
            kept.append(c == '_' || c < ' ' || c > '~' ? ' ' : c);
        }
        return kept.toString();
    }
}
