package leaprig;

/** Cuts bytes into lines, which end with LF, CR or both; what is longer than the limit is dropped to its end. */
final class Lines {
    static final int LONGEST = 1024;
    private final char[] line = new char[LONGEST];
    private int length;
    private boolean tooLong;

    /** Takes a byte; returns the line that it ends, else null. Empty lines and those that were too long are null. */
    String take(int value) {
        if (value != '\n' && value != '\r') {
            if (length == LONGEST) tooLong = true;
            else line[length++] = (char) (value & 0xFF);
            return null;
        }
        String done = tooLong || length == 0 ? null : new String(line, 0, length);
        length = 0;
        tooLong = false;
        return done;
    }
}
