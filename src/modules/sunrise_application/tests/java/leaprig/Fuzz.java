package leaprig;

import java.util.Random;

/** Sessions of random words, numbers and bytes, in time that is handed in. */
public final class Fuzz {
    private static final String[] NUMBERS = {
        "0", "0.1", "-0.5", "1", "7", "1e-3", "3.2", "-3.2", "100", "1e400", "-1e400", "NaN", "Infinity", "-Infinity", "nan",
        "", " ", "x", "0x1p3", "1d", "9999999999999999999999", "-0.0", "5e-324", "\u00e9", "\0",
    };

    private Fuzz() { }

    public static void main(String[] arguments) {
        long ends = System.nanoTime() + (long) (1e9 * Double.parseDouble(arguments[0]));
        long seed = Long.parseLong(arguments[1]);
        long lines = 0;
        while (System.nanoTime() < ends) lines += run(seed++, 100);
        System.out.println(lines + " lines, last seed " + (seed - 1));
    }

    static long run(long seed, int sessions) {
        Random random = new Random(seed);
        long lines = 0;
        for (int k = 0; k < sessions; k++) {
            Bench bench = new Bench();
            Lines splitter = new Lines();
            if (random.nextInt(3) > 0) bench.ask("lrHello_1_");
            if (random.nextBoolean()) bench.ask("lrTool_1_0_0_60_0_0_106_0_0_0_");
            bench.arm.lasts = random.nextDouble();
            for (int i = 0; i < 60; i++) {
                String text = line(random);
                lines++;
                for (int c = 0; c < text.length(); c++) {
                    String whole = splitter.take(text.charAt(c));
                    if (whole == null) continue;
                    String said = bench.ask(whole);
                    Bench.check(said.isEmpty() || said.endsWith("\n"), "whole lines are answered");
                }
                if (random.nextInt(20) == 0) bench.second(text.trim());
                if (random.nextInt(30) == 0) bench.arm.torques[random.nextInt(7)] = 20 * random.nextGaussian();
                if (random.nextInt(100) == 0) bench.arm.stop = random.nextBoolean() ? "STOP1" : "NOSTOP";
                bench.run(random.nextInt(4) == 0 ? 0.3 * random.nextDouble() : 0.002);
            }
            bench.session.leave(bench.client);
            bench.run(2);
            Bench.check(!bench.arm.servoing, "a client that is gone leaves no servo mode");
            Bench.check(bench.session.admit("next", new Bench.Line(), 1, bench.now) == null, "the next one is admitted");
            for (String sentence : bench.log)
                Bench.check(!sentence.contains("AssertionError") && !sentence.contains("NullPointer")
                        && !sentence.contains("OutOfBounds"), sentence);
        }
        return lines;
    }

    private static String line(Random random) {
        Word[] words = Word.values();
        Word word = words[random.nextInt(words.length)];
        StringBuilder text = new StringBuilder(word.text);
        int count = random.nextInt(5) > 0 ? word.most : random.nextInt(40);
        for (int i = 0; i < count; i++) {
            if (i > 0 || !word.text.endsWith("_")) text.append('_');
            if (random.nextInt(8) > 0) text.append(random.nextGaussian());
            else text.append(NUMBERS[random.nextInt(NUMBERS.length)]);
        }
        if (random.nextInt(10) == 0 && text.length() > 0)
            text.setCharAt(random.nextInt(text.length()), (char) random.nextInt(256));
        return text.append(random.nextInt(50) == 0 ? "\r" : "\n").toString();
    }
}
