package leaprig;

/** How a servo motion holds its goal. */
final class Soft {
    enum Kind { STIFF, JOINTS, TOOL, FLOAT, TOOLBOX }

    static final Soft STIFF = new Soft(Kind.STIFF, null);
    final Kind kind;
    /** JOINTS: seven stiffnesses, damping. TOOL: six stiffnesses, damping, null space, force, moment, path [mm], [rad].
     * TOOLBOX: mass, centre [mm], stiffness along, about, null space, as the toolbox's word has them. */
    final double[] numbers;

    Soft(Kind kind, double[] numbers) {
        this.kind = kind;
        this.numbers = numbers;
    }

    /** Returns why the numbers are refused, or null; the ranges are those of KUKA's control modes. */
    String refusal() {
        if (kind == Kind.JOINTS) {
            String no = Limits.refuse("a joint's stiffness", numbers, 0, 7, 0, 5000);
            return no != null ? no : Limits.refuse("the damping", numbers, 7, 8, 0.1, 1);
        }
        if (kind != Kind.TOOL) return null;
        String[] whats = {"a stiffness along an axis", "a stiffness about an axis", "the damping",
            "the null space's stiffness", "the force", "the moment", "the path's deviation in mm",
            "the path's deviation in rad"};
        int[] ends = {0, 3, 6, 7, 8, 9, 10, 11, 12};
        double[] lows = {0, 0, 0.1, 0, 1, 0.1, 1, 0.01};
        double[] highs = {5000, 300, 1, 1000, 200, 50, 500, 2};
        for (int i = 0; i < whats.length; i++) {
            String no = Limits.refuse(whats[i], numbers, ends[i], ends[i + 1], lows[i], highs[i]);
            if (no != null) return no;
        }
        return null;
    }
}
