package leaprig;

/** One line, read: its word and its numbers, or what is wrong with them. Used again for the next line. */
final class Request {
    static final int MOST = 32;
    private static final int LONGEST = 64;
    Word word;
    final double[] numbers = new double[MOST];
    int count;
    int stops;
    Object from;
    String fault;

    /** Reads a line without its end. Fields are joined with `_`; empty ones are skipped, as the toolbox does. */
    void read(String line) {
        word = Word.of(line);
        count = 0;
        fault = null;
        if (word == null || word.most == 0) return;
        int at = line.indexOf('_');
        while (at >= 0 && fault == null) {
            int next = line.indexOf('_', at + 1);
            String field = line.substring(at + 1, next < 0 ? line.length() : next);
            at = next;
            if (!field.isEmpty()) add(field);
        }
    }

    private void add(String field) {
        if (count == MOST) {
            fault = "more than " + MOST + " numbers";
            return;
        }
        if (field.length() <= LONGEST) {
            try {
                numbers[count] = Double.parseDouble(field);
                count++;
                return;
            } catch (NumberFormatException e) {
                // told below
            }
        }
        fault = "field " + (count + 1) + " is not a number";
    }

    /** Returns why a client that said hello is refused: not a number, too few, too many, not finite; else null. */
    String refusal() {
        if (fault != null) return fault;
        if (count < word.least || count > word.most)
            return count + " numbers came, " + (word.least == word.most ? "" : word.least + " to ") + word.most + " are needed";
        return finite() ? null : "a number is not finite";
    }

    boolean finite() {
        for (int i = 0; i < count; i++)
            if (Double.isNaN(numbers[i]) || Double.isInfinite(numbers[i])) return false;
        return true;
    }

    /** Returns what the main thread gets: with the count of stops so far, and who said it. */
    Request copy(int stopsSoFar, Object connection) {
        Request other = new Request();
        other.word = word;
        System.arraycopy(numbers, 0, other.numbers, 0, count);
        other.count = count;
        other.fault = fault;
        other.stops = stopsSoFar;
        other.from = connection;
        return other;
    }
}
